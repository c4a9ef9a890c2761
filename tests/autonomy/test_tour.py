"""The order of visits."""

import itertools

import numpy as np
import pytest

from ursnav_torch.autonomy.tour import Tour


@pytest.fixture(scope="module")
def tour(phantom):
    return Tour(phantom, 3.0)


@pytest.mark.parametrize("start", ["root", 0, 3, 5])
def test_the_order_is_the_shortest_of_all(tour, phantom, start):
    place = phantom.pelvis_mm if start == "root" else phantom.calyces[start].tip_mm
    calyces = [c for c in range(6) if c != start]
    found = tour.order(place, calyces)
    shortest = min(tour.length_mm(place, order) for order in itertools.permutations(calyces))
    assert sorted(found) == calyces
    assert tour.length_mm(place, found) == pytest.approx(shortest)


def test_those_that_are_late_come_last_in_their_own_shortest_order(tour, phantom):
    found = tour.order(phantom.pelvis_mm, range(6), late=[0, 4])
    assert set(found[4:]) == {0, 4}
    assert found[:4] == tour.order(phantom.pelvis_mm, [1, 2, 3, 5])


def test_a_visit_ends_before_the_tip(phantom):
    there, short = Tour(phantom, 0.0), Tour(phantom, 4.0)
    saved = there.length_mm(phantom.pelvis_mm, [2]) - short.length_mm(phantom.pelvis_mm, [2])
    assert saved == pytest.approx(4.0, abs=1.0)  # to a node of the centerline
    assert there.length_mm(phantom.calyces[2].tip_mm, [2]) == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(short.length_mm(phantom.pelvis_mm, range(6)))


def test_a_visit_goes_no_farther_than_its_end_and_the_order_is_still_the_shortest(phantom):
    ends = [np.inf, 4.0, 9.0, np.inf, 2.0, np.inf]
    cut, whole = Tour(phantom, 3.0, ends), Tour(phantom, 3.0)
    for calyx, most in enumerate(ends):
        there = cut.length_mm(phantom.centerline.points_mm[0], [calyx])
        assert there <= most and (there > most - 1.5 or most == np.inf)
        assert there == whole.length_mm(phantom.centerline.points_mm[0], [calyx]) or most < np.inf
    found = cut.order(phantom.pelvis_mm, range(6))
    shortest = min(cut.length_mm(phantom.pelvis_mm, order) for order in itertools.permutations(range(6)))
    assert cut.length_mm(phantom.pelvis_mm, found) == pytest.approx(shortest)


def test_nothing_to_visit_has_no_order(tour, phantom):
    assert tour.order(phantom.pelvis_mm, []) == []
