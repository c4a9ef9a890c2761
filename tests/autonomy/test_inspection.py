"""The inspection of a calyx: views are weighed while it stands, taken up, held, and ended where none shows more."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import later

from ursnav_torch.autonomy.inspection import Inspection
from ursnav_torch.autonomy.next_view import ViewPlan
from ursnav_torch.exploration.coverage import CoverageSettings

#: Wall that the planner's views would show.
PATCHES = np.array([3, 5])


class Plans:
    """A planner that has so many candidates, of which the best is known from the second on."""

    def __init__(self, best: ViewPlan | None) -> None:
        self.best, self.least, self.given_up, self.fine = best, [], [], []
        self.seen = np.zeros(9, bool)
        self.coverage = SimpleNamespace(of_kidney=CoverageSettings(), seen=lambda: self.seen)

    def candidates(self, seen, T, calyx, least_gain, given_up, fine):
        self.least.append(least_gain)
        self.fine.append(fine)
        self.given_up.append(given_up.tolist())
        yield None
        for _ in range(5):
            yield self.best


@pytest.fixture
def begun(explorer, at_root):
    """An inspection that begins in the pelvis, by a planner of the test's."""

    def begin(best: ViewPlan | None):
        inspection = Inspection(Plans(best), explorer._steering, explorer.settings)
        inspection.begin(at_root)
        return inspection

    return begin


@pytest.fixture
def on_its_way(begun, at_root):
    """An inspection on its way to a view, what it was told last, and the pose (4, 4)."""
    inspection = begun(ViewPlan(at_root.bend_rad + 0.3, at_root.insertion_mm, 0.2, 0.01, PATCHES))
    seen, T = at_root, at_root.T_kidney_camera
    while inspection.step(seen, T, 0, 0.5).is_still:
        seen = later(seen, 0.02)
    return inspection, seen, T


def test_it_stands_while_views_are_weighed_goes_to_the_best_holds_it_and_weighs_anew(begun, at_root) -> None:
    there = ViewPlan(at_root.bend_rad + 0.3, at_root.insertion_mm, 0.2, 0.01, PATCHES)
    inspection, T, seen = begun(there), at_root.T_kidney_camera, at_root
    still = 0
    while (wish := inspection.step(seen, T, 0, 0.5)).is_still:
        seen, still = later(seen, 0.02), still + 1
    assert still >= 3 and (wish.bend_rad_s > 0).all()
    seen = later(seen, 0.02, bend_rad=there.bend_rad)
    for _ in range(20):
        inspection.step(seen, T, 0, 0.5)
        seen = later(seen, 0.02)
    assert len(inspection._planner.least) == 1, "held"
    for _ in range(20):
        inspection.step(seen := later(seen, 0.02), T, 0, 0.01)
    least = inspection._planner.least
    assert len(least) == 2 and least[1] == 0.005 < least[0], "near the end, small steps are worth it"


def test_where_no_view_shows_more_it_says_so(begun, at_root) -> None:
    inspection = begun(None)
    answers = [inspection.step(at_root, at_root.T_kidney_camera, 0, 0.5) for _ in range(8)]
    assert answers[-1] is None and all(wish is not None for wish in answers[:-1])
    assert inspection._planner.fine == [False, True], "more views are weighed before it gives up"


def test_a_view_that_cannot_be_reached_is_left_after_a_while(on_its_way) -> None:
    inspection, seen, T = on_its_way
    assert not inspection.step(later(seen, 3.9), T, 0, 0.5).is_still
    assert inspection.step(later(seen, 4.2), T, 0, 0.5).is_still


def test_only_its_own_time_counts(begun, at_root) -> None:
    """Who lets go of the button for half a minute has not looked at the calyx for half a minute."""
    inspection, T, seen = begun(None), at_root.T_kidney_camera, at_root
    for _ in range(3):
        inspection.step(seen := later(seen, 0.1), T, 0, 0.5)
    inspection.begin(seen := later(seen, 30.0))
    inspection.step(later(seen, 0.1), T, 0, 0.5)
    assert inspection.lasted_s == pytest.approx(0.4)
    inspection.reset()
    assert inspection.lasted_s == 0.0


def test_a_view_is_held_for_as_long_as_pictures_count(begun, at_root) -> None:
    """A place surely known to no better than coverage asks for paints nothing, so that the view is held on."""
    inspection, T = begun(ViewPlan(at_root.bend_rad, at_root.insertion_mm, 0.2, 0.01, PATCHES)), at_root.T_kidney_camera
    seen = at_root
    while inspection._view is None:
        inspection.step(seen := later(seen, 0.02), T, 0, 0.5)
    for _ in range(100):
        inspection.step(seen := later(seen, 0.02, position_sd_mm=1.0), T, 0, 0.5)
    assert len(inspection._planner.least) == 1, "2 s"
    for _ in range(24):
        inspection.step(seen := later(seen, 0.02, position_sd_mm=0.3), T, 0, 0.5)
    assert inspection._view is None


def test_a_view_is_gone_to_on_after_a_stop(on_its_way) -> None:
    """Ten seconds of standing in doubt are no part of the time that a view may take."""
    inspection, seen, T = on_its_way
    inspection.resume(seen := later(seen, 10.0))
    assert not inspection.step(later(seen, 3.9), T, 0, 0.5).is_still
    assert inspection.lasted_s < 5.0 and len(inspection._planner.least) == 1


def test_wall_that_two_views_were_to_show_and_did_not_is_given_up(begun, at_root) -> None:
    inspection, T = begun(ViewPlan(at_root.bend_rad, at_root.insertion_mm, 0.2, 0.01, PATCHES)), at_root.T_kidney_camera
    inspection._planner.seen[3] = True
    seen, plans = at_root, inspection._planner
    while len(plans.given_up) < 4:
        inspection.step(seen := later(seen, 0.02), T, 0, 0.5)
    assert plans.given_up == [[], [], [5], [5]]
    inspection.reset()
    inspection.step(seen, T, 0, 0.5)
    assert plans.given_up[-1] == [], "another calyx"
