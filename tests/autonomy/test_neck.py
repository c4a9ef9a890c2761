"""Necks that are too narrow and stones in the way: found on the way, named, and not gone into."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import HELD, later

from ursnav_torch.autonomy import Explorer, State
from ursnav_torch.autonomy.neck import find_neck, find_stone
from ursnav_torch.autonomy.steering import Way
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.geometry import look_along
from ursnav_torch.stones import GONE, THERE, FoundStone

CALYX = 3


def narrowest(way):
    """The smallest radius (index, mm) of a way, but for its last 4 mm."""
    before_end = way.along_mm <= way.length_mm - ScopeLimits().short_mm
    at = int(np.where(before_end, way.radius_mm, np.inf).argmin())
    return at, float(way.radius_mm[at])


def test_a_neck_is_found_where_the_lumen_is_narrower_than_the_scope(phantom):
    way = Way(phantom, CALYX)
    at, radius = narrowest(way)
    assert find_neck(way, ScopeLimits(radius_mm=radius - 0.01), 1.0) is None
    neck = find_neck(way, ScopeLimits(radius_mm=radius + 0.01), 1.0)
    assert neck is not None and neck.radius_mm == radius and neck.needed_mm == radius + 0.01
    begins = way.length_mm - neck.to_tip_mm
    assert begins <= way.along_mm[at] and neck.end_mm == pytest.approx(begins - 1.0)
    np.testing.assert_allclose(neck.T_kidney_camera[:3, 3], way.point_at(neck.end_mm))
    ahead = way.point_at(neck.end_mm + 4.0) - way.point_at(neck.end_mm)
    assert neck.T_kidney_camera[:3, 2] @ ahead == pytest.approx(np.linalg.norm(ahead))


def test_what_narrows_at_the_end_of_a_way_is_no_neck(phantom):
    way = Way(phantom, CALYX)
    least = float(way.radius_mm[way.along_mm > way.length_mm - 2.0].min())
    assert find_neck(way, ScopeLimits(radius_mm=min(least, narrowest(way)[1]) - 1e-6), 1.0) is None
    way.radius_mm = np.where(way.along_mm > way.length_mm - 2.0, 0.1, 9.0)
    assert find_neck(way, ScopeLimits(), 1.0) is None


def explorer_for(phantom, lumen, lens, vid, radius_mm):
    coverage = Coverage(phantom, lens, lumen, vid.T_kidney_camera[::2])
    return Explorer(coverage, lumen, limits=ScopeLimits(radius_mm=radius_mm))


def test_it_ends_before_a_neck_and_says_why(phantom, phantom_lumen, lens, vid, at_root):
    explorer = explorer_for(phantom, phantom_lumen, lens, vid, narrowest(Way(phantom, CALYX))[1] + 0.01)
    seen = at_root
    for _ in range(10):
        seen = later(seen, 0.1)
        explorer.step(seen, HELD)
        if explorer.machine.state is State.APPROACHING:
            break
    explorer.target, neck = CALYX, explorer._bars[CALYX]
    T = seen.T_kidney_camera.copy()
    T[:3, 3] = explorer._ways[CALYX].point_at(neck.end_mm + 0.5)
    for _ in range(40):
        seen = later(seen, 0.1)
        explorer.step(replace(seen, T_kidney_camera=T), HELD)
        if explorer.machine.state is State.INSPECTING:
            break
    assert explorer.machine.state is State.INSPECTING
    explorer._close(replace(seen, T_kidney_camera=T), "no view from here shows more of it")
    assert explorer.visits[CALYX].verdict == "not reached"
    assert "narrows to a radius of" in explorer.visits[CALYX].reason


def test_behind_every_neck_it_is_looked_however_little_of_the_wall_shows(phantom, phantom_lumen, lens, vid, at_root):
    """A stone may lie there."""
    explorer = explorer_for(phantom, phantom_lumen, lens, vid, 50.0)
    hidden = [c for c, bar in enumerate(explorer._bars) if explorer._shown(c, bar) < explorer._least[0]]
    for number in (1, 2, 3):
        explorer.step(later(at_root, 0.1 * number), HELD)
    assert hidden and not [v for v in explorer.visits if v.verdict == "not reached"]
    assert {*hidden} <= {*explorer._tour.order(at_root.T_kidney_camera[:3, 3], range(len(explorer.visits)), ())}


def stone_at(center_mm, size_mm, size_sd_mm=0.2, state=THERE):
    """A stone as the map tells it."""
    return FoundStone(1, CALYX, np.asarray(center_mm, float), 0.01 * np.eye(3), size_mm, size_sd_mm, 9, 0.99, state, 0)


def wide_way(phantom):
    """A way whose lumen is 3 mm wide all along, and a place on it 9 mm before its end."""
    way = Way(phantom, CALYX)
    way.radius_mm = np.full_like(way.radius_mm, 3.0)
    return way, way.length_mm - 9.0


def test_a_stone_bars_the_way_where_the_scope_has_too_little_room_beside_it(phantom):
    way, at = wide_way(phantom)
    center, limits = way.point_at(at), ScopeLimits(radius_mm=1.0)
    assert find_stone(way, [stone_at(center, 1.8, 0.0)], limits, 1.0) is None, "2.1 mm are free beside it"
    bar = find_stone(way, [stone_at(center, 2.2, 0.0)], limits, 1.0)
    assert bar is not None, "1.9 mm are free beside it"
    assert bar.end_mm == pytest.approx(at - 1.1 - 1.0, abs=0.1) and bar.to_tip_mm == pytest.approx(10.1, abs=0.1)
    np.testing.assert_allclose(bar.T_kidney_camera[:3, 3], way.point_at(bar.end_mm))
    assert bar.reason("D") == "a stone of 2 mm bars the way 10 mm before the tip of calyx D"


def test_beside_a_stone_on_the_wall_there_is_more_room(phantom):
    way, at = wide_way(phantom)
    along = way.point_at(at + 0.5) - way.point_at(at - 0.5)
    aside = np.cross(along, [0.3, 0.5, 0.8])
    center = way.point_at(at) + 1.5 * aside / np.linalg.norm(aside)
    assert find_stone(way, [stone_at(center, 3.0, 0.0)], ScopeLimits(radius_mm=1.0), 1.0) is None
    assert find_stone(way, [stone_at(center, 6.0, 0.0)], ScopeLimits(radius_mm=1.0), 1.0) is not None


def test_only_a_stone_that_is_there_and_surely_too_large_bars_the_way_and_the_first_does(phantom):
    way, at = wide_way(phantom)
    center, limits = way.point_at(at), ScopeLimits(radius_mm=1.0)
    assert find_stone(way, [stone_at(center, 4.0, state=GONE)], limits, 1.0) is None
    assert find_stone(way, [stone_at(center, 3.0, size_sd_mm=1.5)], limits, 1.0) is None
    assert find_stone(way, [stone_at(way.point_at(way.length_mm), 4.0)], limits, 1.0) is None, "it may end before"
    first = find_stone(way, [stone_at(center, 4.0), stone_at(way.point_at(at - 6.0), 4.0)], limits, 1.0)
    assert first is not None and first.end_mm < at - 6.0


def test_a_stone_told_on_the_way_ends_it_before_the_stone_and_the_account_names_it(explorer, at_root):
    seen = at_root
    while explorer.machine.state is not State.APPROACHING:
        seen = later(seen, 0.1)
        explorer.step(seen, HELD)
    calyx, way = explorer.target, explorer._ways[explorer.target]
    at = way.length_mm - 9.0
    stone = stone_at(way.point_at(at), 2 * way.radius_at(at) + 0.4)
    seen = replace(seen, T_kidney_camera=seen.T_kidney_camera.copy(), stones=(stone,))
    seen.T_kidney_camera[:3, 3] = way.point_at(at - stone.size_mm / 2 - 0.9)
    for _ in range(60):
        seen = later(seen, 0.1)
        wish = explorer.step(seen, HELD)
        if explorer.machine.state is not State.APPROACHING:
            break
        assert wish.insertion_mm_s <= explorer.settings.advance_mm_s
    assert explorer.machine.state is State.INSPECTING and explorer.visits[calyx].attempts == 0
    explorer._close(seen, "no view from here shows more of it")
    visit = explorer.visits[calyx]
    assert visit.verdict == "not reached" and visit.reason.startswith("a stone of ") and "bars the way" in visit.reason


def test_a_stone_that_is_gone_bars_the_way_no_more(explorer, at_root):
    way = explorer._ways[CALYX]
    at = way.length_mm - 9.0
    stone = stone_at(way.point_at(at), 2 * way.radius_at(at) + 0.4)
    explorer.step(later(at_root, 0.1, stones=(stone,)), HELD)
    assert explorer._bars[CALYX] is not None
    explorer.step(later(at_root, 0.2, stones=(replace(stone, state=GONE),)), HELD)
    assert explorer._bars[CALYX] is None


def test_wall_seen_from_past_a_stone_in_the_way_does_not_count(explorer, at_root):
    """The scope cannot be there: it is the place that is wrong. Once the stone is gone, it may."""
    way, coverage = explorer._ways[CALYX], explorer.coverage
    stone = stone_at(way.point_at(way.length_mm - 9.0), 2 * way.radius_at(way.length_mm - 9.0) + 0.4)
    explorer.step(later(at_root, 0.1, stones=(stone,)), HELD)
    end = explorer._bars[CALYX].end_mm
    for at, counts in ((end - 1.0, True), (end + 1.5, True), (end + 3.5, False)):
        coverage.seen_s[:] = 0
        T = look_along(way.point_at(at), way.point_at(at + 2.0) - way.point_at(at))
        assert explorer.is_past_a_stone(T) is not counts
        coverage.add(T, 0.1)
        assert coverage.seen_s.any() == counts, at
    explorer.step(later(at_root, 0.2, stones=(replace(stone, state=GONE),)), HELD)
    assert not explorer.is_past_a_stone(T)


def test_wall_seen_from_in_a_neck_counts(phantom, phantom_lumen, lens, vid, at_root):
    """It is left out as too narrow, and still a tip may get some way in."""
    explorer = explorer_for(phantom, phantom_lumen, lens, vid, 50.0)
    explorer.step(later(at_root, 0.1), HELD)
    assert explorer._bars[CALYX] is not None
    assert not explorer.is_past_a_stone(vid.T_kidney_camera[vid.calyx == CALYX][3])
