"""The figures printed and ours."""

import numpy as np
import pytest

from ursnav_torch.registration import Confusion
from ursnav_torch.thesis import Figure, beside_text
from ursnav_torch.thesis.figures import agreement, counts, r_squared, r_squared_text, spread


def test_r_squared_is_that_of_the_fitted_line() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(100, 500, 24)
    y = 0.01 * x + rng.normal(0, 0.3, 24)
    slope, start = np.polyfit(x, y, 1)
    rest = 1 - np.sum((y - slope * x - start) ** 2) / np.sum((y - y.mean()) ** 2)
    assert r_squared(x, y) == pytest.approx(rest, abs=1e-12)
    with_gaps = np.append(x, np.nan), np.append(y, 3.0)
    assert r_squared(*with_gaps) == pytest.approx(rest, abs=1e-12)


def test_no_r_squared_where_points_hardly_vary() -> None:
    points = np.full(24, 100.0)
    assert np.isnan(r_squared(points, np.random.default_rng(0).uniform(size=24)))
    assert "as many points" in r_squared_text(points, np.ones(24))
    assert "too few pictures" in r_squared_text(np.full(24, np.nan), np.ones(24))


def test_the_thesis_s_matrix_reads_as_it_prints_it() -> None:
    printed = Confusion(14, 1, 2, 7)
    assert counts(printed) == "14, 1, 2, 7" and agreement(printed) == "21 of 24"


def test_spread_passes_over_what_is_missing() -> None:
    assert spread(np.array([3.0, np.nan, 1.0, 2.0]), "{:.0f}") == "2 (1 to 3)"
    assert spread(np.array([np.nan]), "{:.0f}") == "none"


def test_table_has_both_columns_aligned() -> None:
    head, rule, row = beside_text([Figure("threshold", "15.10", "", "Eq. 5.3")]).splitlines()
    assert head.index("thesis") == row.index("15.10") and head.index("ours") == row.index("-")
    assert set(rule) == {"-", " "}
