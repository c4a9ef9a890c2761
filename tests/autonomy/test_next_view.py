"""The next view: what it adds is wall not yet seen, of two that add as much the nearer is taken, and walls count."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.autonomy.free_space import FreeSpace
from ursnav_torch.autonomy.next_view import ViewPlanner
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.kinematics import Segment
from ursnav_torch.stones import GONE, THERE, FoundStone

CALYX = 2


@pytest.fixture
def planner(phantom, phantom_lumen, lens, vid):
    coverage = Coverage(phantom, lens, phantom_lumen, vid.T_kidney_camera[::2])
    return ViewPlanner(coverage, FreeSpace(phantom_lumen), Segment(), 0.8, np.radians(120), 20.0)


@pytest.fixture
def before(vid, at_root):
    """A perception from before the calyx."""
    return replace(at_root, T_kidney_camera=vid.T_kidney_camera[vid.calyx == CALYX][3], bend_rad=np.zeros(2))


def best(planner, seen, least=0.0):
    return list(planner.candidates(seen, seen.T_kidney_camera, CALYX, least))[-1]


def test_it_gets_better_as_views_are_weighed_and_what_was_seen_adds_nothing(planner, before):
    found = list(planner.candidates(before, before.T_kidney_camera, CALYX, 0.0))
    worth = [p.worth for p in found if p is not None]
    assert worth == sorted(worth) and worth[-1] > 0 and 0 < found[-1].gain <= 1
    own = planner.coverage.patches.calyx == CALYX
    planner.coverage.seen_s[own] = 9.0
    assert best(planner, before) is None


def test_what_adds_less_than_asked_for_is_no_view(planner, before):
    gain = best(planner, before).gain
    assert best(planner, before, least=1.0) is None
    assert best(planner, before, least=0.9 * gain).gain >= 0.9 * gain


def test_of_a_place_that_may_be_off_less_is_promised(planner, before):
    sure, unsure = best(planner, before), best(planner, replace(before, position_sd_mm=1.0))
    assert unsure is None or unsure.worth < sure.worth


def test_a_view_says_what_wall_it_shows_and_wall_that_was_given_up_counts_for_none(planner, before):
    plan = best(planner, before)
    coverage = planner.coverage
    assert (
        coverage.share(CALYX, plan.patches) == pytest.approx(plan.gain)
        and (coverage.patches.calyx[plan.patches] == CALYX).all()
    )
    found = list(planner.candidates(before, before.T_kidney_camera, CALYX, 0.0, plan.patches))[-1]
    assert found is None or not {*found.patches} & {*plan.patches}


def test_among_more_views_there_is_one_as_good_or_nearly(planner, before):
    usual = list(planner.candidates(before, before.T_kidney_camera, CALYX, 0.0))
    more = list(planner.candidates(before, before.T_kidney_camera, CALYX, 0.0, fine=True))
    assert len(more) > 3 * len(usual) and more[-1].worth > 0.8 * usual[-1].worth
    assert all(np.hypot(*p.bend_rad) <= planner.largest_bend_rad for p in more if p is not None)


@pytest.mark.parametrize(("state", "stops"), [(THERE, True), (GONE, False)])
def test_no_view_goes_on_into_a_stone_that_is_there(planner, at_root, state, stops):
    T, bend, size = at_root.T_kidney_camera, at_root.bend_rad, 3.0
    center = T[:3, 3] + (1.0 + size / 2) * T[:3, 2]
    planner.space.stones = (FoundStone(1, CALYX, center, 0.01 * np.eye(3), size, 0.2, 9, 0.99, state, 0),)
    assert (planner._pose(T, bend, bend, 1.5) is None) is stops
    assert planner._pose(T, bend, bend, -1.5) is not None
