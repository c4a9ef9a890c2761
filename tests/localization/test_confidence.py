"""What a ranking says about the calyx, and how sure that makes an answer."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ursnav_torch.localization.confidence import Confidence, Evidence, evidence, fit

PICTURE = SimpleNamespace(contrast=-1.5, grain=0.2)


def said(distance: list[float], calyx: list[int]) -> Evidence:
    return evidence(np.array(distance), np.array(calyx), PICTURE)  # type: ignore[arg-type]


def test_near_best_views_vote_and_a_distance_of_0_012_more_counts_an_e_th() -> None:
    seen = said([0.1, 0.112], [4, 2])
    assert seen.calyx == 4 and seen.vote == pytest.approx(1 / (1 + math.exp(-1)), abs=1e-3)
    assert said([0.1, 0.101, 0.101], [4, 2, 2]).calyx == 2  # two nearly as near outvote the nearest
    assert said([0.1, 0.2, 0.2, 0.2], [4, 2, 2, 2]).calyx == 4  # but far ones do not


def test_the_margin_is_how_much_farther_the_next_calyx_is() -> None:
    seen = said([0.1, 0.15, 0.3], [4, 4, 1])
    assert seen.distance == pytest.approx(0.1) and seen.margin == pytest.approx(0.2)
    assert said([0.1, 0.101, 0.102], [4, 2, 2]).margin == pytest.approx(-0.001, abs=1e-6)  # outvoted
    assert said([0.1, 0.2], [-1, -1]).margin == 1.0 and said([0.1, 0.2], [-1, -1]).vote == 1.0


def test_the_numbers_are_distance_margin_odds_contrast_and_grain() -> None:
    numbers = said([0.1, 0.112], [4, 2]).numbers()
    np.testing.assert_allclose(numbers, [0.1, 0.012, 1.0, -1.5, 0.2], atol=1e-4)
    assert said([0.1], [0]).numbers()[1] == 0.15  # no other calyx: as far as counts
    assert np.isfinite(said([0.1], [0]).numbers()).all()


def test_confidence_is_the_logistic_function_of_the_numbers() -> None:
    sure = Confidence((0.5, 2.0, -1.0))
    assert sure.probability(np.array([1.0, 0.5])) == pytest.approx(1 / (1 + math.exp(-2.0)))
    assert sure.probability(np.array([1e9, 0.0])) > 0.999999 and sure.probability(np.array([-1e9, 0.0])) < 1e-6
    assert sure.probability(np.array([np.nan, 0.0])) == 0.0


def test_without_calibration_it_is_the_vote() -> None:
    for refined, more in ((False, []), (True, [0.9, 1.0])):
        plain = Confidence.from_calibration(None, refined)
        numbers = np.append(said([0.1, 0.112], [4, 2]).numbers(), more)
        assert plain.probability(numbers) == pytest.approx(1 / (1 + math.exp(-1)), abs=1e-3)


def test_answers_with_and_without_refinement_have_weights_of_their_own() -> None:
    stored = {"confidence": {"refined": [1.0, 2.0, 3.0], "nearest": [4.0, 5.0]}}
    assert Confidence.from_calibration(stored, True).weights == (1.0, 2.0, 3.0)
    assert Confidence.from_calibration(stored, False).weights == (4.0, 5.0)


def test_what_is_fitted_is_calibrated_and_ranks_by_what_tells() -> None:
    rng = np.random.default_rng(0)
    telling, noise = rng.normal(3.0, 2.0, 4000), rng.normal(50.0, 7.0, 4000)
    right = rng.random(4000) < 1 / (1 + np.exp(-(telling - 3.0)))
    found = fit(np.column_stack([telling, noise]), right)
    told = np.array([found.probability(row) for row in np.column_stack([telling, noise])])
    assert found.weights[1] == pytest.approx(1.0, abs=0.15) and abs(found.weights[2]) < 0.02
    for low in (0.0, 0.25, 0.5, 0.75):
        here = (told >= low) & (told < low + 0.25)
        assert right[here].mean() == pytest.approx(told[here].mean(), abs=0.06)


def test_what_other_settings_taught_is_not_used_unmarked() -> None:
    stored = {"confidence": {"settings": "nearest", "refined": [1.0, 2.0], "nearest": [4.0, 5.0]}}
    assert Confidence.from_calibration(stored, True, "nearest").weights == (1.0, 2.0)
    other = Confidence.from_calibration(stored, True, "sinkhorn")
    assert other.weights == () and math.isnan(other.probability(np.array([0.1])))
