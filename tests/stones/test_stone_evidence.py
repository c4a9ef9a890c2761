"""What decides about stones, one thing at a time: numbers, merging, cones of sight, contact, what the edge cuts."""

from dataclasses import replace

import numpy as np
import pytest
from stone_views import answer, ball_bodies, ball_on_wall, stone_watch, way_in

from ursnav_torch.camera import Camera
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.stones import THERE, FoundStone, StoneMap, StoneMapSettings, residual_fragments, watch_stones
from ursnav_torch.stones.ball import Cones, contact_depth_mm, fit_ball
from ursnav_torch.stones.candidate import StoneCandidate
from ursnav_torch.stones.sighting import ConeOfSight
from ursnav_torch.tracking.tracker import SEARCHING, Tracker
from ursnav_torch.vid import Vid

RADIUS, SD = 1.6, (0.2, 0.02)


@pytest.fixture
def stones(phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera) -> StoneMap:
    return StoneMap(phantom, phantom_lumen, lens, StoneMapSettings(size_factor=1.0))


def begun_twice(stones: StoneMap, lens: Camera) -> tuple[StoneCandidate, StoneCandidate]:
    """One stone that became two candidates."""
    center = ball_on_wall(stones.kidney, stones.lumen, 0, RADIUS)
    for T in way_in(stones.kidney, 0, 24):
        seen = ConeOfSight(lens).sightings(ball_bodies(lens, stones.lumen, T, [(center, RADIUS)]))
        if seen and seen[0].is_whole:
            break
    first, second = (stones._begin(T, seen[0], SD, frame) for frame in (0, 1))
    for candidate in (first, second):
        candidate.settle(stones.lumen.clearance_mm)
    return first, second


def test_what_is_seen_once_takes_no_number(stones: StoneMap, lens: Camera) -> None:
    kidney, lumen = stones.kidney, stones.lumen
    speck, stone = (ball_on_wall(kidney, lumen, calyx, RADIUS) for calyx in (3, 0))
    shown = next(T for T in way_in(kidney, 3, 24) if ball_bodies(lens, lumen, T, [(speck, RADIUS)]))
    stones.add(shown, ball_bodies(lens, lumen, shown, [(speck, RADIUS)]), 0.0)
    assert stones.stones() == ()
    for i, T in enumerate(way_in(kidney, 0, 24)):
        stones.add(T, ball_bodies(lens, lumen, T, [(stone, RADIUS)]), 100 + 0.3 * i)
    assert [s.number for s in stones.stones()] == [1]


def test_candidates_at_one_place_become_one(stones: StoneMap, lens: Camera) -> None:
    first, _ = begun_twice(stones, lens)
    stones._merge([first])
    assert len(stones._candidates) == 1 and stones._candidates[0].pictures == 2


@pytest.mark.parametrize(("beside", "left"), [(0, 1), (2, 2)])
def test_candidates_seen_beside_each_other_stay_two_though_they_are_near(
    stones: StoneMap, lens: Camera, beside: int, left: int
) -> None:
    first, second = begun_twice(stones, lens)
    gap = 0.65 * (first.ball.radius_mm + second.ball.radius_mm)
    second.ball = replace(second.ball, center_mm=first.ball.center_mm + np.array([0.0, 0.0, gap]))
    first.apart[second.key] = second.apart[first.key] = beside
    stones._merge([first])
    assert len(stones._candidates) == left


@pytest.mark.parametrize("distance", [4.0, 8.0])
def test_convention_a_cones_half_angle_is_a_balls_apparent_radius(lens: Camera, distance: float) -> None:
    rays, inside = lens.pixel_rays()
    at = distance * np.array([0.1, -0.2, 0.97]) / np.linalg.norm([0.1, -0.2, 0.97])
    half = float(np.arcsin(RADIUS / distance))
    mask = inside & (rays @ at / distance > np.cos(half))
    (body,) = ball_bodies(lens, _Open(), np.eye(4), [(at, RADIUS)])
    (seen,) = ConeOfSight(lens).sightings((replace(body, mask=mask),))
    assert seen.half_angle == pytest.approx(half, rel=0.05) and seen.extent == pytest.approx(2 * half, rel=0.08)
    assert seen.ray @ at / distance > np.cos(np.radians(1.0)) and seen.is_whole


class _Open:
    """No walls."""

    @staticmethod
    def clearance_mm(points: np.ndarray) -> np.ndarray:
        return np.full(len(points), 100.0)


def test_a_ball_touches_the_first_wall_and_none_behind_it() -> None:
    def room(points: np.ndarray) -> np.ndarray:
        """A wall from 10 to 12 mm, and another cavity behind it to 20 mm."""
        z = points[:, 2]
        return np.where(z < 10, 10 - z, np.where(z < 12, -1.0, np.minimum(z - 12, 20 - z)))

    depth = contact_depth_mm(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.2, room, 25.0)
    assert depth == pytest.approx(10 / (1 + np.sin(0.2)), abs=0.15)


def test_what_the_edge_cuts_tells_a_least_size_only() -> None:
    """Ten pictures that show a part of a ball do not make it smaller than two that show all of it."""
    center, radius, rng = np.array([0.0, 0.0, 10.0]), 2.0, np.random.default_rng(0)
    origin = rng.uniform(-3, 3, (12, 3)) * [1, 1, 0.3]
    way = center - origin
    distance = np.linalg.norm(way, axis=1)
    whole = np.arange(12) < 2
    half = np.arcsin(radius / distance) * np.where(whole, 1.0, 0.4)
    cones = Cones(origin, way / distance[:, None], half, whole, np.full(12, 0.1), np.full(12, 0.01))
    ball = fit_ball(cones, lambda points: 12.0 - points[:, 2], StoneMapSettings())
    assert ball.radius_mm == pytest.approx(radius, rel=0.05)
    np.testing.assert_allclose(ball.center_mm, center, atol=0.3)


def test_a_pose_that_is_not_settled_places_nothing(phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera) -> None:
    watch = stone_watch(phantom, phantom_lumen, lens)
    center = ball_on_wall(phantom, phantom_lumen, 0, RADIUS)
    for i, T in enumerate(way_in(phantom, 0, 24)):
        told = answer(T, ball_bodies(lens, phantom_lumen, T, [(center, RADIUS)]))
        watch.see(replace(told, state=SEARCHING), np.zeros((4, 4), np.uint8), 0.3 * i, i)
    assert watch.stones.best_frames() == set() and watch.found().seen == ()


@pytest.mark.parametrize(("alike_mm", "shrinks"), [(0.5, False), (0.0, True)])
def test_of_pictures_from_one_place_the_one_that_shows_most_tells_the_size(
    phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera, alike_mm: float, shrinks: bool
) -> None:
    """The finder sees all of a stone once, and less of it for as long as the scope stands still before it."""
    stones = StoneMap(phantom, phantom_lumen, lens, StoneMapSettings(size_factor=1.0, alike_mm=alike_mm))
    center = ball_on_wall(phantom, phantom_lumen, 0, RADIUS)
    ways = [(T, ball_bodies(lens, phantom_lumen, T, [(center, RADIUS)])) for T in way_in(phantom, 0, 24)]
    all_of_it = [(T, b) for T, b in ways if b and ConeOfSight(lens).sightings(b)[0].is_whole]
    T, whole = max(all_of_it, key=lambda way: way[1][0].share)
    less = ball_bodies(lens, phantom_lumen, T, [(center, 0.5 * RADIUS)])
    for frame in range(30):
        stones.add(T, less if frame % 10 else whole, 0.3 * frame, frame, SD)
    (found,) = stones.told()
    assert (found.size_mm < 1.5 * RADIUS) == shrinks


@pytest.mark.parametrize(
    ("size_mm", "sd_mm", "step_mm", "listed"),
    [(2.1, 0.1, 0.0, True), (1.8, 0.3, 0.0, False), (1.8, 0.3, 1.0, True), (1.8, 0.1, 1.0, False)],
)
def test_what_may_be_a_stone_is_one_where_two_places_show_it(
    stones: StoneMap, lens: Camera, size_mm: float, sd_mm: float, step_mm: float, listed: bool
) -> None:
    candidate, _ = begun_twice(stones, lens)
    T, _, seen, *sd = candidate._views.telling()[0]
    pose = np.eye(4)
    pose[:3, 3] = T + step_mm * np.eye(3)[0]
    candidate.see(pose, seen, (sd[0], sd[1]), 1, 1.0)
    assert candidate.is_stone(size_mm, sd_mm) is listed


@pytest.mark.parametrize(("radius", "listed"), [(0.65, 0), (1.3, 1)])
def test_what_is_smaller_than_a_stone_is_told_as_a_fragment(
    phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera, radius: float, listed: int
) -> None:
    watch = stone_watch(phantom, phantom_lumen, lens)
    center = ball_on_wall(phantom, phantom_lumen, 0, radius)
    for i, T in enumerate(way_in(phantom, 0, 24)):
        watch.see(answer(T, ball_bodies(lens, phantom_lumen, T, [(center, radius)])), np.zeros((4, 4), np.uint8), i, i)
    found = watch.found()
    assert (len(found.seen), len(found.fragments)) == (listed, 1 - listed)
    assert len(watch.stones.stones()) == listed and len(watch.stones.told()) == 1


def test_a_tracker_is_told_which_stones_hide_the_wall(vid: Vid, phantom_lumen: LumenDistance, lens: Camera) -> None:
    tracker = Tracker(vid)
    watch = watch_stones(tracker, StoneMapSettings(size_factor=1.0))
    center = ball_on_wall(vid.kidney, phantom_lumen, 0, RADIUS)
    for i, T in enumerate(way_in(vid.kidney, 0, 24)):
        bodies = ball_bodies(tracker.working_camera, phantom_lumen, T, [(center, RADIUS)])
        watch.see(answer(T, bodies), np.zeros((4, 4), np.uint8), 0.3 * i, i)
    np.testing.assert_allclose(tracker.known.balls_mm, [[*center, RADIUS]], atol=0.6)


def test_a_fragment_counts_from_above_two_mm(phantom: Kidney) -> None:
    def of_size(mm: float) -> FoundStone:
        return FoundStone(1, 0, np.zeros(3), np.eye(3), mm, 0.1, 9, 0.99, THERE, 0)

    assert residual_fragments([of_size(1.9), of_size(2.0)], phantom) == {}
    assert residual_fragments([of_size(2.1), of_size(1.9)], phantom) == {phantom.calyces[0].name: 1}
