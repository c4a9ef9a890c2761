"""Stones get their places, sizes and calyces from outlines and poses, and are told only on evidence."""

import numpy as np
import pytest
from stone_views import ball_bodies, ball_on_wall, way_in

from ursnav_torch.camera import Camera
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.stones import GONE, THERE, StoneMap, StoneMapSettings

RADIUS = 1.6


@pytest.fixture
def stones(phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera) -> StoneMap:
    return StoneMap(phantom, phantom_lumen, lens, StoneMapSettings(size_factor=1.0))  # outlines are whole here


def test_a_ball_at_a_known_place_is_recovered_from_its_outlines(stones: StoneMap, lens: Camera) -> None:
    kidney, lumen = stones.kidney, stones.lumen
    for calyx in (0, 3):
        center = ball_on_wall(kidney, lumen, calyx, RADIUS)
        for number, T in enumerate(way_in(kidney, calyx, 24)):
            stones.add(T, ball_bodies(lens, lumen, T, [(center, RADIUS)]), 100 * calyx + 0.3 * number, number)
        (found,) = [s for s in stones.stones() if s.calyx == calyx]
        assert np.linalg.norm(found.center_mm - center) < 0.4
        assert found.size_mm == pytest.approx(2 * RADIUS, rel=0.12)
        assert found.state == THERE and found.confidence > 0.9
    assert [s.number for s in stones.stones()] == [1, 2]


def test_nothing_is_told_of_pictures_without_stones(stones: StoneMap) -> None:
    assert stones.stones() == ()
    for number, T in enumerate(way_in(stones.kidney, 0, 8)):
        stones.add(T, (), 0.3 * number)
    assert stones.stones() == ()


def test_a_stone_met_again_is_the_same_one(stones: StoneMap, lens: Camera) -> None:
    center = ball_on_wall(stones.kidney, stones.lumen, 1, RADIUS)
    for visit in range(2):
        for number, T in enumerate(way_in(stones.kidney, 1, 16, seed=visit)):
            bodies = ball_bodies(lens, stones.lumen, T, [(center, RADIUS)])
            stones.add(T, bodies, 100.0 * visit + 0.3 * number)
    (found,) = stones.stones()
    assert found.number == 1 and found.pictures > 20


def test_a_stone_that_is_taken_out_is_gone(stones: StoneMap, lens: Camera) -> None:
    center = ball_on_wall(stones.kidney, stones.lumen, 2, RADIUS)
    for visit, there in enumerate((True, False, False)):
        for number, T in enumerate(way_in(stones.kidney, 2, 16, seed=visit)):
            balls = [(center, RADIUS)] if there else []
            stones.add(T, ball_bodies(lens, stones.lumen, T, balls), 100.0 * visit + 0.3 * number)
        if visit == 0:
            assert [s.state for s in stones.stones()] == [THERE]
            np.testing.assert_allclose(stones.balls_mm(), [[*center, RADIUS]], atol=0.6)
    assert [s.state for s in stones.stones()] == [GONE] and stones.balls_mm().shape == (0, 4)


def test_a_stone_behind_the_wall_is_not_missed(stones: StoneMap, lens: Camera) -> None:
    """Pictures of another calyx say nothing of a stone that wall hides from them."""
    center = ball_on_wall(stones.kidney, stones.lumen, 0, RADIUS)
    for number, T in enumerate(way_in(stones.kidney, 0, 16)):
        stones.add(T, ball_bodies(lens, stones.lumen, T, [(center, RADIUS)]), 0.3 * number)
    (before,) = stones.stones()
    for number, T in enumerate(way_in(stones.kidney, 3, 30)):
        stones.add(T, (), 100 + 0.3 * number)
    (after,) = stones.stones()
    assert after.state == THERE and after.confidence == before.confidence


def test_two_stones_side_by_side_stay_two(stones: StoneMap, lens: Camera) -> None:
    balls = [(ball_on_wall(stones.kidney, stones.lumen, calyx, 1.0), 1.0) for calyx in (0, 0)]
    balls[1] = (balls[0][0] + 2.4 * np.array([0.0, 0.0, 1.0]), 1.0)
    for number, T in enumerate(way_in(stones.kidney, 0, 24)):
        bodies = tuple(b for ball in balls for b in ball_bodies(lens, stones.lumen, T, [ball]))
        stones.add(T, bodies, 0.3 * number)
    assert len(stones.stones()) == 2
