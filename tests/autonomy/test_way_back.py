"""The way back in the joints, to where the place was known."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import HELD, later

from ursnav_torch.autonomy import State
from ursnav_torch.autonomy.way_back import WayBack, joints
from ursnav_torch.kinematics import Segment


@pytest.fixture
def way_back():
    return WayBack(Segment(), 1.0)


def gone_back(way_back, here):
    """The joints that it leads back to, one after the other."""
    found = []
    while (to := way_back.next(here)) is not None:
        found.append(to.tolist())
        here = joints(to[:2], min(to[2], here[2]))
    return found


def test_it_leads_back_as_it_came(way_back):
    came = [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.2, 0.0, 4.0], [0.4, 0.1, 6.0]]
    for passed in came:
        way_back.add(np.array(passed))
    assert gone_back(way_back, np.array([0.7, -0.2, 8.0])) == came[::-1]
    assert way_back.next(np.zeros(3)) is None, "and forgets what it was led through"


def test_drawn_back_a_little_it_was_bent_as_on_the_way_in(way_back):
    for passed in ([0.0, 0.0, 0.0], [0.2, 0.0, 4.0], [0.4, 0.1, 6.0], [1.0, 0.9, 6.2]):
        way_back.add(np.array(passed))
    assert way_back.before(np.array([1.0, 0.9, 6.2])).tolist() == [0.2, 0.0, 4.0], "not as it looked about there"
    assert way_back.before(np.array([0.0, 0.0, 0.2])) is None


def test_loops_and_what_was_drawn_back_are_no_part_of_it(way_back):
    for n in range(12):
        way_back.add(np.array([0.0, 0.0, float(n)]))
    for turn in np.linspace(0, 2 * np.pi, 30):  # round and back to where it was
        way_back.add(np.array([0.6 * np.sin(turn), 0.6 - 0.6 * np.cos(turn), 11.0]))
    way_back.add(np.array([0.0, 0.0, 5.0]))
    assert gone_back(way_back, np.array([0.0, 0.0, 5.0])) == [[0.0, 0.0, float(n)] for n in range(4, -1, -1)]


def test_joints_lie_a_step_apart_and_it_never_leads_farther_in(way_back):
    for mm in np.arange(0.0, 6.0, 0.05):
        way_back.add(np.array([0.0, 0.0, mm]))
    found = gone_back(way_back, np.array([0.5, 0.0, 3.3]))
    assert 3 <= len(found) <= 5
    way_back.add(np.array([0.0, 0.0, 3.0]))
    assert way_back.next(np.array([0.02, 0.0, 2.7])) is None, "near enough, but for what would have to be pushed"


def test_who_loses_the_place_goes_back_to_the_bend_with_which_it_was_known(explorer, at_root):
    seen = replace(at_root, bend_rad=np.zeros(2))
    for bend, insertion in ((0.0, 8.0), (0.0, 10.0), (0.3, 10.0), (0.3, 13.0)):
        seen = later(seen, 0.1, bend_rad=np.array([bend, 0.0]), insertion_mm=insertion)
        explorer.step(seen, HELD)
    seen = replace(seen, bend_rad=np.array([0.3, 0.6]), T_kidney_camera=None)
    passed = []
    for _ in range(3000):
        seen = later(seen, 0.02)
        wish = explorer.step(seen, HELD)
        if explorer.machine.state is State.WITHDRAWING:
            bend, push = seen.bend_rad + 0.02 * wish.bend_rad_s, seen.insertion_mm + 0.02 * wish.insertion_mm_s
            seen = replace(seen, bend_rad=bend, insertion_mm=push)
            passed.append([*bend, push])
        if explorer.finished or seen.insertion_mm < 9.0:
            break
    passed = np.array(passed)
    drawn = passed[passed[:, 2] < 12.9]
    assert np.hypot(*(drawn[drawn[:, 2] > 10.5, :2] - [0.3, 0.0]).T).max() < 0.25, "bent as it came in"
    assert np.hypot(*drawn[drawn[:, 2] < 9.3, :2].T).max() < 0.25, "straight where it was"
    assert (np.diff(passed[:, 2]) <= 1e-9).all()
