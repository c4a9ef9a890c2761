"""Routes along the centerline: lengths, branches, bends and refusals."""

import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.exploration.route import ScopeLimits, bend_needed_deg, branch_names, nearest_route, route_to
from ursnav_torch.kidney import Calyx, Centerline, Kidney

#: Root at the origin, a stem of 10 mm along x, then A straight on (20 mm) and B at a right angle (15 mm).
STEM = [[x, 0, 0] for x in range(11)]
TO_A = [[10 + x, 0, 0] for x in range(1, 21)]
TO_B = [[10, y, 0] for y in range(1, 16)]


@pytest.fixture(scope="module")
def fork() -> Kidney:
    points = np.array([*STEM, *TO_A, *TO_B], float)
    parent = np.array([*range(-1, 10), 10, *range(11, 30), 10, *range(31, 45)])
    calyx = np.array([-1] * 11 + [0] * 20 + [1] * 15)
    tree = Centerline(points, np.full(len(points), 3.0), parent, calyx)
    calyces = (Calyx("A", points[30]), Calyx("B", points[45]))
    return Kidney(trimesh.creation.box((60, 60, 10)), calyces, tree, points[0], 1.0, "a fork drawn by hand")


def test_the_way_from_the_root_is_the_centerline(fork: Kidney) -> None:
    route = route_to(fork, np.array([0.0, 0.5, 0.0]), 0)
    assert route.length_mm == pytest.approx(30.0)
    assert route.back_mm == 0.0
    assert route.branches == ("pelvis", "calyx A")
    np.testing.assert_allclose(route.points_mm[-1], [30, 0, 0])


def test_from_one_calyx_to_the_other_the_scope_is_pulled_back_to_the_fork(fork: Kidney) -> None:
    route = route_to(fork, np.array([22.0, 0.0, 0.2]), 1)
    assert route.back_mm == pytest.approx(12.0)
    assert route.length_mm == pytest.approx(12.0 + 15.0)
    assert route.branches == ("calyx A", "pelvis", "calyx B")


def test_a_straight_way_needs_no_bend_and_a_corner_its_angle(fork: Kidney) -> None:
    assert bend_needed_deg(fork, 0, ScopeLimits()) == pytest.approx(0.0, abs=1e-6)
    assert bend_needed_deg(fork, 1, ScopeLimits()) == pytest.approx(90.0, abs=1.0)


def test_limits_decide_what_is_feasible(fork: Kidney) -> None:
    at = np.zeros(3)
    assert route_to(fork, at, 1).feasible
    assert not route_to(fork, at, 1, ScopeLimits(largest_bend_deg=80.0)).feasible
    assert not route_to(fork, at, 1, ScopeLimits(radius_mm=3.5)).feasible


def test_the_nearest_is_the_shortest_that_is_feasible(fork: Kidney) -> None:
    at = np.array([8.0, 0.0, 0.0])
    nearest = nearest_route(fork, at, [0, 1])
    assert nearest is not None and nearest.calyx == "B"
    stiff = nearest_route(fork, at, [0, 1], ScopeLimits(largest_bend_deg=45.0))
    assert stiff is not None and stiff.calyx == "A"
    assert nearest_route(fork, at, []) is None


def test_every_calyx_of_a_phantom_has_a_way_that_ends_at_its_tip(phantom: Kidney) -> None:
    for index, calyx in enumerate(phantom.calyces):
        route = route_to(phantom, phantom.pelvis_mm, index)
        assert np.linalg.norm(route.points_mm[-1] - calyx.tip_mm) < 1.5
        assert route.branches[-1] == f"calyx {calyx.name}"
        assert route.length_mm >= np.linalg.norm(calyx.tip_mm - route.points_mm[0]) - 1.5


def test_branches_name_what_they_lead_to(phantom: Kidney) -> None:
    names = branch_names(phantom)
    assert names[0] == "pelvis"
    assert {f"calyx {c.name}" for c in phantom.calyces} <= set(names)


def test_an_unknown_calyx_and_impossible_limits_are_refused(fork: Kidney) -> None:
    with pytest.raises(InputError, match="calyces 0 to 1, got 2"):
        route_to(fork, np.zeros(3), 2)
    with pytest.raises(InputError, match="must be positive"):
        ScopeLimits(bending_length_mm=0)
