"""The next target: nearest unseen first, never one out of reach, and the same live as in a track's report."""

import numpy as np
import pytest
from stone_views import stone_watch

from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.exploration.coverage_report import coverage_report
from ursnav_torch.exploration.target import next_target
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.navigation import Guide
from ursnav_torch.vid import Vid

HIDDEN = 2


@pytest.fixture
def guide(vid: Vid, phantom_lumen: LumenDistance) -> Guide:
    """Nothing of one calyx's wall is within reach of any view."""
    guide = Guide(vid, phantom_lumen, stone_watch(vid.kidney, phantom_lumen, vid.camera))
    patches = guide.coverage.patches
    guide.coverage.in_reach = guide.coverage.in_reach & (patches.calyx != HIDDEN)
    return guide


def see(coverage: Coverage, *calyces: int) -> None:
    coverage.seen_s[np.isin(coverage.patches.calyx, calyces)] = 1.0


def others(vid: Vid) -> list[int]:
    return [i for i in range(len(vid.kidney.calyces)) if i != HIDDEN]


def test_a_calyx_out_of_reach_is_no_target_live_or_in_the_report(guide: Guide, vid: Vid) -> None:
    see(guide.coverage, *others(vid))
    T = vid.T_kidney_camera[np.flatnonzero(vid.calyx == HIDDEN)[0]]  # right in front of it
    assert guide.coverage.calyces()[HIDDEN].verdict == "out of reach"
    assert next_target(guide.coverage, T[:3, 3]) is None
    assert guide.guidance(T).route is None
    assert coverage_report(guide.coverage, T)["next"] is None


def test_track_and_navigate_name_the_same_target_from_everywhere(guide: Guide, vid: Vid) -> None:
    see(guide.coverage, 0)
    for T in vid.T_kidney_camera[::10]:
        live, report = guide.guidance(T).route, coverage_report(guide.coverage, T)["next"]
        assert live is not None and live.calyx == report["calyx"]
        assert live.calyx not in (vid.calyx_name(0), vid.calyx_name(HIDDEN))


def test_the_nearest_unseen_comes_before_a_nearer_glimpsed_one(guide: Guide, vid: Vid) -> None:
    near, far = 0, 4
    see(guide.coverage, *(i for i in others(vid) if i not in (near, far)))
    own = np.flatnonzero(guide.coverage.patches.calyx == near)
    guide.coverage.seen_s[own[: len(own) // 3]] = 1.0
    assert guide.coverage.calyces()[near].verdict == "glimpsed"
    at = vid.T_kidney_camera[np.flatnonzero(vid.calyx == near)[0], :3, 3]
    route = next_target(guide.coverage, at)
    assert route is not None and route.calyx == vid.calyx_name(far)
    see(guide.coverage, far)
    route = next_target(guide.coverage, at)
    assert route is not None and route.calyx == vid.calyx_name(near)


def test_the_way_shown_is_to_where_autonomy_heads_and_a_persons_choice_goes_before_it(
    guide: Guide, phantom: Kidney
) -> None:
    T = np.eye(4)
    T[:3, 3] = phantom.centerline.points_mm[0]
    names = [c.name for c in phantom.calyces]
    other = next(i for i, name in enumerate(names) if name != guide.guidance(T).route.calyx)
    guide.headed = other
    shown = guide.guidance(T)
    assert (shown.route.calyx, shown.chosen) == (names[other], "")
    guide.chosen = (other + 1) % len(names)
    assert guide.guidance(T).route.calyx == names[guide.chosen]
