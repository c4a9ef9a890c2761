import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.features.sampling import bending, chain, sample

METHODS = ["uniform", "farthest", "curvature"]
RNG = np.random.default_rng(0)


def outline(corners: list[tuple[float, float]]) -> np.ndarray:
    """Pixels along a polyline, shuffled."""
    pieces = []
    for a, b in itertools.pairwise(map(np.array, corners)):
        steps = int(np.abs(b - a).max())
        pieces.append(np.round(a + (b - a) * np.arange(steps)[:, None] / steps))
    return np.random.default_rng(0).permutation(np.unique(np.vstack(pieces), axis=0))


SQUARE = outline([(0, 0), (100, 0), (100, 100), (0, 100), (0, 0)])
PARTS = np.vstack([SQUARE, outline([(200, 0), (300, 0)]), outline([(200, 50), (250, 100)])])


@pytest.mark.parametrize("method", METHODS)
def test_gives_n_different_indices(method: str) -> None:
    for n in (1, 2, 40, len(PARTS) - 1, len(PARTS), len(PARTS) + 5):
        found = sample(PARTS, n, method)
        assert len(np.unique(found)) == len(found) == min(n, len(PARTS))
        assert (np.diff(found) > 0).all()


@pytest.mark.parametrize("method", ["uniform", "farthest"])
def test_spacing_is_even(method: str) -> None:
    kept = SQUARE[sample(SQUARE, 40, method)]
    apart = np.linalg.norm(kept[:, None] - kept[None], axis=2) + 1e9 * np.eye(40)
    assert apart.min(1).min() >= 4  # 10 px apart along the square if it were perfect
    assert apart.min(1).max() <= 15


def test_uniform_goes_by_length_not_by_the_count_of_pixels() -> None:
    level, diagonal = outline([(0, 0), (100, 0)]), outline([(300, 0), (400, 100)])
    kept = sample(np.vstack([level, diagonal]), 48, "uniform")
    assert (kept >= len(level)).sum() == pytest.approx(48 * 2**0.5 / (1 + 2**0.5), abs=1)


def test_curvature_keeps_corners() -> None:
    corners = np.array([(0, 0), (100, 0), (100, 100), (0, 100)])
    for_curvature, for_length = SQUARE[sample(SQUARE, 30, "curvature")], SQUARE[sample(SQUARE, 30, "uniform")]

    def near_corners(kept: np.ndarray) -> int:
        return int((np.linalg.norm(kept[:, None] - corners[None], axis=2).min(1) < 8).sum())

    assert near_corners(for_curvature) >= 1.5 * near_corners(for_length)
    assert np.ptp(for_curvature, axis=0).min() >= 95


@pytest.mark.parametrize("method", METHODS)
def test_weights_draw_points(method: str) -> None:
    left = PARTS[:, 0] < 150
    heavy = sample(PARTS, 50, method, np.where(left, 1.0, 4.0))
    plain = sample(PARTS, 50, method)
    assert (~left[heavy]).sum() > (~left[plain]).sum()
    assert not left[sample(PARTS, 50, method, np.where(left, 0.0, 1.0))].any()


def test_chain_runs_along_the_curve() -> None:
    order, length = chain(SQUARE)
    assert sorted(order) == list(range(len(SQUARE)))
    assert np.linalg.norm(np.diff(SQUARE[order], axis=0), axis=1).max() < 3
    assert length.sum() == pytest.approx(400, rel=0.02)


def test_bending_is_zero_on_a_line_and_rotation_changes_nothing() -> None:
    line = np.stack([np.arange(50.0), 2 * np.arange(50.0)], -1)
    assert bending(line).max() < 1e-9
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    np.testing.assert_allclose(np.sort(bending(SQUARE)), np.sort(bending(SQUARE @ turn)), atol=0.2)


@settings(max_examples=60, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(0, 9), st.just(2)), elements=st.integers(0, 3)), st.integers(1, 9))
def test_doubled_and_few_points_are_fine(points: np.ndarray, n: int) -> None:
    for method in METHODS:
        found = sample(points, n, method)
        assert len(np.unique(found)) == len(found) == min(n, len(points))


def test_refuses_what_it_cannot_use() -> None:
    with pytest.raises(ShapeError, match=r"points \(N, 2\)"):
        sample(np.zeros((3, 3)), 2)
    with pytest.raises(ShapeError, match=r"weights \(N,\)"):
        sample(np.zeros((3, 2)), 2, weights=[1.0])
    with pytest.raises(InputError, match="at least 1"):
        sample(SQUARE, 0)
    with pytest.raises(InputError, match="'uniform', 'farthest', 'curvature'"):
        sample(SQUARE, 3, "random")
    with pytest.raises(InputError, match=">= 0"):
        sample(SQUARE, 3, weights=np.full(len(SQUARE), -1.0))


def test_an_unknown_sampling_is_refused_with_the_settings_not_at_the_first_picture() -> None:
    with pytest.raises(InputError, match="arc_length"):
        DefaultSettings(sampling="arc_length")


def test_farthest_is_the_plain_loop() -> None:
    """Again and again the point that is farthest from those chosen, times its weight."""
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(0, 100, (300, 2)), rng.uniform(0.1, 1, 300)
    chosen: list[int] = []
    away = ((points - points.mean(0)) ** 2).sum(1)
    for _ in range(40):
        chosen.append(int(np.argmax(away * (weights + 1e-9) ** 2)))
        away = ((points[:, None] - points[chosen]) ** 2).sum(2).min(1)
    assert sample(points, 40, "farthest", weights).tolist() == sorted(chosen)
