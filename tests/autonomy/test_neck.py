"""Necks that are too narrow: found on the way, named, and not entered."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import HELD, later

from ursnav_torch.autonomy import Explorer, State
from ursnav_torch.autonomy.neck import find_neck
from ursnav_torch.autonomy.steering import Way
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage

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
    explorer.target, neck = CALYX, explorer._necks[CALYX]
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


def test_what_is_hidden_behind_a_neck_is_named_without_going_there(phantom, phantom_lumen, lens, vid, at_root):
    explorer = explorer_for(phantom, phantom_lumen, lens, vid, 50.0)
    for number in (1, 2, 3):
        explorer.step(later(at_root, 0.1 * number), HELD)
    hidden = [v for v in explorer.visits if v.verdict == "not reached"]
    assert hidden and all("and the scope needs 50.0 mm" in v.reason and v.attempts == 0 for v in hidden)
    assert not [v for v in explorer.visits if v.verdict == "inspected"]
