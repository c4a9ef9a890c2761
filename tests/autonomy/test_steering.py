"""From a pose and a way to rates."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ursnav_torch.autonomy import AutonomySettings, Perception
from ursnav_torch.autonomy.free_space import FreeSpace
from ursnav_torch.autonomy.steering import Steering, Way
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kinematics import Segment
from ursnav_torch.stones import GONE, THERE, FoundStone

SEEN = Perception(0.0)


@pytest.fixture(scope="module")
def steering(phantom_lumen):
    return Steering(FreeSpace(phantom_lumen), Segment(), AutonomySettings())


@pytest.mark.parametrize("calyx", range(6))
def test_a_place_on_the_way_is_found_where_it_is(phantom, calyx):
    way = Way(phantom, calyx)
    for mm in np.linspace(0.0, way.length_mm, 9):
        assert way.place_mm(way.point_at(mm)) == pytest.approx(mm, abs=0.05)
    np.testing.assert_allclose(way.point_at(1e9), phantom.calyces[calyx].tip_mm)


def test_how_far_beside_the_way_a_place_is(phantom):
    way, other = Way(phantom, 0), Way(phantom, 5)
    assert way.away_mm(way.point_at(4.0)) == pytest.approx(0.0, abs=1e-9)
    tip = phantom.calyces[0].tip_mm
    assert way.away_mm(tip) == pytest.approx(0.0, abs=1e-9)
    assert other.away_mm(tip) == pytest.approx(np.linalg.norm(other.points_mm - tip, axis=1).min(), abs=0.5)


def test_ways_share_what_lies_before_their_branching(phantom):
    one, other = Way(phantom, 0), Way(phantom, 5)
    shared = one.shared_mm(other)
    assert shared == pytest.approx(other.shared_mm(one)) and one.shared_mm(one) == pytest.approx(one.length_mm)
    np.testing.assert_allclose(one.point_at(shared), other.point_at(shared), atol=1e-9)
    assert np.linalg.norm(one.point_at(shared + 3.0) - other.point_at(shared + 3.0)) > 0.5


def on_the_way(way, mm, sideways=0.0):
    """A pose on a way, looking along it or aside."""
    T = look_along(way.point_at(mm), way.point_at(mm + 5.0) - way.point_at(mm))
    c, s = np.cos(sideways), np.sin(sideways)
    T[:3, :3] = T[:3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return T


def test_along_the_way_it_goes_on_and_off_it_it_only_turns(phantom, steering):
    way = Way(phantom, 5)
    ahead = steering.advance(SEEN, on_the_way(way, 3.0), way)
    aside = steering.advance(SEEN, on_the_way(way, 3.0, 1.0), way)
    assert ahead.insertion_mm_s > 2.0 and np.linalg.norm(ahead.bend_rad_s) < 0.1
    assert aside.insertion_mm_s == 0.0 and aside.bend_rad_s[1] < -0.5, "back about y, the way that it looked aside"


@pytest.mark.parametrize(("state", "slows"), [(THERE, True), (GONE, False)])
def test_it_goes_slower_towards_a_stone_that_is_told_of(phantom, phantom_lumen, state, slows):
    way, space, size = Way(phantom, 5), FreeSpace(phantom_lumen), 2.0
    T, steering = on_the_way(way, 3.0), Steering(space, Segment(), AutonomySettings())
    free = steering.advance(SEEN, T, way).insertion_mm_s
    center = T[:3, 3] + (1.2 + size / 2) * T[:3, 2]
    space.stones = (FoundStone(1, 5, center, 0.01 * np.eye(3), size, 0.2, 9, 0.99, state, 0),)
    assert (steering.advance(SEEN, T, way).insertion_mm_s < 0.5 * free) is slows


def test_it_goes_slower_the_less_it_knows_where_it_is(steering):
    speeds = [steering.sureness(replace(SEEN, position_sd_mm=sd)) for sd in (None, 0.1, 1.0, 2.0, 9.0)]
    assert speeds[0] == speeds[1] == 1.0 and speeds == sorted(speeds, reverse=True) and 0 < speeds[-1] < 0.2


def test_a_wall_that_faces_the_scope_is_not_gone_into_and_along_one_it_creeps(phantom, phantom_lumen, steering):
    root = phantom.centerline.points_mm[0]
    sideways = np.cross(Way(phantom, 5).point_at(3.0) - root, [0.0, 0.0, 1.0])
    sideways /= np.linalg.norm(sideways)
    places = root + np.arange(0.0, 9.0, 0.05)[:, None] * sideways
    near = places[np.flatnonzero(phantom_lumen.clearance_mm(places) < 0.9)[0]]
    room = phantom_lumen.clearance_mm(np.concatenate([near + 0.3 * np.eye(3), near - 0.3 * np.eye(3)]))
    to_wall = room[3:] - room[:3]
    assert steering.freedom(look_along(near, to_wall), 0.8) == 0.0
    assert steering.freedom(look_along(near, -to_wall), 0.8) == 1.0
    along = np.cross(to_wall, [0.0, 0.0, 1.0])
    slanted = along / np.linalg.norm(along) + 0.5 * to_wall / np.linalg.norm(to_wall)
    assert 0.2 < steering.freedom(look_along(near, slanted), 0.8) < 0.5


def test_along_a_wall_it_creeps_no_nearer_than_it_may_touch(phantom, phantom_lumen, steering):
    way = Way(phantom, 5)
    careful = replace(steering, settings=replace(steering.settings, touch_mm=0.7))
    across = np.cross(way.point_at(6.0) - way.point_at(3.0), [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    places = way.point_at(3.0) + np.arange(0.0, 9.0, 0.02)[:, None] * across
    told = []
    for room in (1.2, 0.5):
        place = places[np.flatnonzero(phantom_lumen.clearance_mm(places) < room)[0]]
        around = phantom_lumen.clearance_mm(np.concatenate([place + 0.3 * np.eye(3), place - 0.3 * np.eye(3)]))
        to_wall = (around[3:] - around[:3]) / np.linalg.norm(around[3:] - around[:3])
        along = np.cross(to_wall, [0.0, 0.0, 1.0])
        T = look_along(place, along / np.linalg.norm(along) + 0.04 * to_wall)
        told.append((steering.freedom(T, 0.8), careful.freedom(T, 0.8)))
    assert told[0][1] == told[0][0] > 0 and told[1][0] > 0 == told[1][1], told


def test_retreating_and_withdrawing_pull(phantom, steering):
    way = Way(phantom, 2)
    assert steering.retreat(SEEN, on_the_way(way, 10.0), way).insertion_mm_s < 0
    assert steering.withdraw(replace(SEEN, insertion_mm=9.0), np.array([0.0, 0.0, 8.0])).insertion_mm_s < 0


def test_a_tip_that_retreats_is_bent_as_on_the_way_in_and_drawn_back_the_faster_the_nearer_it_is(phantom, steering):
    way = Way(phantom, 0)
    T, bend = on_the_way(way, 10.0), np.asarray(SEEN.bend_rad)
    wishes = [steering.retreat(SEEN, T, way, np.array([bend[0] + aside, bend[1], 3.0])) for aside in (0.0, 0.5, 2.0)]
    assert [w.bend_rad_s[0] for w in wishes] == pytest.approx([0.0, 0.5 * 1.5, 2.0 * 1.5])
    assert [w.insertion_mm_s / wishes[0].insertion_mm_s for w in wishes] == pytest.approx([1.0, 0.5, 0.2])
    assert wishes[0].insertion_mm_s == pytest.approx(-steering.settings.retreat_mm_s)


def test_a_tip_that_withdraws_is_bent_as_it_was_before_the_shaft_is_drawn_back(steering):
    seen, to, bends = replace(SEEN, bend_rad=np.array([0.5, -0.2]), insertion_mm=9.0), np.array([-0.1, 0.3, 6.0]), []
    for _ in range(400):
        wish = steering.withdraw(seen, to)
        assert wish.insertion_mm_s <= 0
        if wish.insertion_mm_s < 0:
            bends.append(np.hypot(*(seen.bend_rad - to[:2])))
        bend, push = seen.bend_rad + 0.02 * wish.bend_rad_s, seen.insertion_mm + 0.02 * wish.insertion_mm_s
        seen = replace(seen, bend_rad=bend, insertion_mm=push)
    assert max(bends) < 0.25, "what it is off as it is drawn back"
    np.testing.assert_allclose([*seen.bend_rad, seen.insertion_mm], to, atol=0.05)


def test_looking_about_bends_round_and_never_inserts(steering):
    seen, bends = SEEN, []
    for step in range(300):
        wish = steering.sweep(seen, 2 * np.pi * step / 100)
        assert wish.insertion_mm_s == 0.0
        seen = replace(seen, bend_rad=seen.bend_rad + wish.bend_rad_s * 0.06)
        bends.append(seen.bend_rad)
    size = np.linalg.norm(bends[200:], axis=1)
    assert size.max() < 0.5 and size.min() > 0.25 and np.abs(np.mean(bends[200:], axis=0)).max() < 0.05


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"mode": "auto"}, "none of assist, explore"),
        ({"advance_mm_s": 0.0}, "speeds above 0"),
        ({"attempts": 0}, "at least one attempt"),
        ({"sure_sd_mm": 3.0}, "0 < sure_sd_mm < doubtful_sd_mm"),
        ({"done_share": 1.2}, "done_share"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes, says):
    with pytest.raises(InputError, match=says):
        AutonomySettings(**changes)


def test_a_little_aside_it_does_not_tremble_after_places_that_are_not_sharp(phantom, steering):
    way = Way(phantom, 5)
    T = on_the_way(way, 3.0)
    goal = T[:3, 3] + 5.0 * T[:3, 2]
    assert not steering.turn(SEEN, T, goal + 0.3 * T[:3, 0]).any()
    small, large = (np.linalg.norm(steering.turn(SEEN, T, goal + aside * T[:3, 0])) for aside in (1.0, 3.0))
    assert 0 < small < large


def test_in_a_neck_it_steers_for_what_lies_straight_ahead_and_elsewhere_cuts_corners(phantom, phantom_lumen, steering):
    way = Way(phantom, CALYX)
    bend = max(np.arange(4.0, way.length_mm - 6.0, 0.5), key=lambda mm: corner(way, mm))
    T = on_the_way(way, bend - 2.5)
    far, narrow = way.point_at(way.place_mm(T[:3, 3]) + steering.settings.ahead_mm), Way(phantom, CALYX)
    narrow.radius_mm = np.full_like(way.radius_mm, 1.2)
    walls = Walls(phantom_lumen, (T[:3, 3] + far) / 2)
    tight = replace(steering, space=walls)
    way.radius_mm = np.full_like(way.radius_mm, 5.0)
    np.testing.assert_allclose(tight.goal(T, way), far)
    nearer = tight.goal(T, narrow)
    assert np.linalg.norm(nearer - T[:3, 3]) < 0.8 * np.linalg.norm(far - T[:3, 3])


CALYX = 5


def corner(way, mm):
    """How sharply a way bends there."""
    one, other = way.point_at(mm) - way.point_at(mm - 2.5), way.point_at(mm + 2.5) - way.point_at(mm)
    return -one @ other


class Walls:
    """A lumen that is free but for a ball of 1 mm around one place."""

    def __init__(self, lumen, at_mm):
        self.scale, self._at = lumen.scale, at_mm

    def clearance_mm(self, points_mm):
        """Distance to the ball."""
        return np.linalg.norm(np.asarray(points_mm).reshape(-1, 3) - self._at, axis=1) - 1.0


def test_it_turns_into_a_way_that_it_sees_and_not_from_deep_in_another_calyx(phantom, steering):
    ways = [Way(phantom, calyx) for calyx in range(6)]
    turns = 0
    for one, other in pairwise(ways):
        shared = one.shared_mm(other)
        places = [on_the_way(one, mm) for mm in np.arange(max(shared - 3.0, 0.0), one.length_mm - 3.0)]
        can = [steering.can_turn_into(SEEN, T, other) for T in places]
        turns += any(can)
        assert not can[-1], "deep in another calyx"
    assert turns >= 3


def test_it_does_not_turn_where_its_tip_would_have_to_bend_too_far(phantom, steering):
    way = Way(phantom, CALYX)
    T = on_the_way(way, 3.0)
    T[:3, :3] = T[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # it looks back
    wide = replace(steering, space=Walls(steering.space, [99.0, 99.0, 99.0]))
    assert not wide.can_turn_into(replace(SEEN, bend_rad=np.array([1.5, 0.0])), T, way)
