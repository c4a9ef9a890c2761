"""What OpenCV's extractor is measured to get wrong, and ours must not."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from matching_shapes import blob, rotated, tangents

from ursnav_torch.matching import Matching, Nearest, ShapeContext, shape_distances

METHODS = ["nearest", "sinkhorn", "hungarian"]


def distance(a: np.ndarray, b: np.ndarray, method: str = "nearest", **settings: object) -> float:
    return float(shape_distances([a], [b], method, **settings)[0, 0])


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_1_scale_can_be_left_out_on_both_sides(factor: float) -> None:
    shape, other = blob(0, 100), blob(1, 100)
    assert distance(shape, factor * shape, scale="own") < 0.1 * distance(shape, other, scale="own")


@pytest.mark.parametrize("method", METHODS)
def test_2_no_term_in_raw_pixels_swamps_the_rest(method: str) -> None:
    shapes = [1000 * blob(seed, 60) for seed in range(5)]
    found = shape_distances(shapes, shapes, method)
    assert found.max() <= 2
    assert (found / found.T.clamp_min(1e-3)).max() < 3
    if method == "nearest":
        both = shape_distances(shapes, shapes, method, sides="sum", keep=1.0)
        torch.testing.assert_close(both, both.T, atol=1e-6, rtol=0)


@pytest.mark.parametrize("method", METHODS)
def test_3_different_numbers_of_points_compare(method: str) -> None:
    same = (
        distance(blob(2, 100), blob(2, 200), method, tolerance=0.05)
        if method == "sinkhorn"
        else distance(blob(2, 100), blob(2, 200), method)
    )
    other = [distance(blob(2, 100), blob(seed, 200), method) for seed in range(3, 8)]
    assert same < 0.5 * min(other)


@pytest.mark.parametrize("method", METHODS)
def test_4_six_points_against_twelve_never_throw(method: str) -> None:
    rng = np.random.default_rng(0)
    pairs = [(rng.uniform(0, 100, (6, 2)), rng.uniform(0, 100, (12, 2))) for _ in range(50)]
    assert all(math.isfinite(distance(a, b, method)) for a, b in pairs)


@pytest.mark.parametrize("degrees", [45, 90, 180, 270])
def test_5_rotation_invariance_is_invariant(degrees: float) -> None:
    shape, other = blob(3, 100), blob(4, 100)
    turned = rotated(shape, math.radians(degrees))
    along = [tangents(s) for s in (shape, turned, other)]
    found = shape_distances(
        [shape], [turned, other], frame="tangent", query_directions=along[:1], database_directions=along[1:]
    )
    assert found[0, 0] < 0.1 * found[0, 1]


def test_6_level_upright_and_diagonal_edges_stand_jitter() -> None:
    rng = np.random.default_rng(0)
    steps = np.arange(50.0)
    for direction in ((1, 0), (-1, 0), (0, 1), (1, 1), (1, -1)):
        line = steps[:, None] * np.array(direction) + 100
        assert distance(line, line + rng.normal(0, 1e-3, line.shape)) < 0.01


def test_7_outliers_settings_and_names_are_live() -> None:
    shape = blob(5, 50)
    clutter = np.vstack([shape, np.random.default_rng(1).uniform(60, 190, (20, 2))])
    every, best = (distance(clutter, shape, sides="query_to_view", keep=keep) for keep in (1.0, 0.7))
    assert best < 0.8 * every  # OpenCV's masking of outliers is dead code
    kept = ShapeContext(r_inner=0.05, r_outer=0.7, frame="tangent")  # and its read() forgets radii and rotation
    assert ShapeContext(**dataclasses.asdict(kept)) == kept
    assert type(Matching(method=Nearest()).method).__name__ == "Nearest"  # and one of its costs bears another's name
