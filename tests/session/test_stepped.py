"""A session in simulated time."""

from functools import partial

import numpy as np
import pytest

from ursnav_torch.devices import CommandSample, Frame, OperatorInput, RobotSample
from ursnav_torch.errors import InputError
from ursnav_torch.session import Live, Rig, Stepped, open_session, rehearse, run_session
from ursnav_torch.simulation import SimulatedTime, SteppedCamera, World, make_twin


@pytest.fixture
def hardware():
    return partial(rehearse, make_twin, rate_hz=5.0)


@pytest.fixture
def world(vid, renderer):
    return lambda: World(vid.kidney, renderer, vid.lumen)


def events_of(hardware, world, seconds=1.0):
    with open_session(hardware, world, duration_s=seconds) as session:
        assert isinstance(session.source, Stepped)
        return list(session.source)


def test_pictures_and_cycles_of_control_come_by_simulated_time(hardware, world):
    events = events_of(hardware, world)
    frames = [e.stamp for e in events if isinstance(e, Frame)]
    assert [s.t_mono_s for s in frames] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8], abs=0.021)
    assert [s.sequence for s in frames] == [0, 1, 2, 3, 4]
    commands = [e.stamp for e in events if isinstance(e, CommandSample)]
    assert len(commands) == 50 and np.allclose(np.diff([s.t_mono_s for s in commands]), 0.02)
    assert all(0 <= e.stamp.t_mono_s <= 1.0 for e in events), "no stamp by the world's clock"
    assert [e.stamp.sequence for e in events if isinstance(e, CommandSample)] == list(range(50)), "none counts as lost"


def test_every_machine_makes_the_same_session(hardware, world):
    first, again = events_of(hardware, world), events_of(hardware, world)
    assert [type(e) for e in first] == [type(e) for e in again]
    for one, other in zip(first, again, strict=True):
        if isinstance(one, Frame):
            np.testing.assert_array_equal(one.image, other.image)
        if isinstance(one, RobotSample):
            assert one.joints == other.joints
    joints = [e.joints.insertion_mm for e in first if isinstance(e, RobotSample)]
    assert joints[-1] > 1.0, "and the pilot moved"


def test_the_robot_is_disarmed_at_the_end_and_the_pilots_quit_ends_it(hardware, world):
    with open_session(hardware, world) as session:
        robot = session.source.rig.robot
        pilot = session.source.rig.gamepad.hands
        pilot.read = lambda: OperatorInput(pilot._stamp(), arm=True, quit=session.source._clock.now_s > 0.51)
        summary = run_session(session.source)
        assert summary.counts["CommandSample"] == 27 and summary.lost == {}
        assert robot.gate.state == "disarmed"


def test_what_goes_by_another_clock_is_refused(world):
    with pytest.raises(InputError, match="hardware=rehearsed"):
        Stepped(Rig())
    with pytest.raises(InputError, match="needs a kidney"):
        rehearse(make_twin)
    with pytest.raises(InputError, match="rate_hz must be positive"):
        SteppedCamera(None, SimulatedTime(), 0.0)
    assert Live(Rig()).pace.patient is False


class Slow:
    """A worker that says twice that it took too long."""

    def __init__(self):
        self.asked = self.taken = 0

    def take(self, event):
        self.taken += isinstance(event, Frame)

    def wait(self):
        self.asked += 1
        return self.asked % 3 == 0

    def results(self):
        return []


def test_time_waits_for_a_picture_however_long_it_takes(hardware, world):
    slow = Slow()
    with open_session(hardware, world, duration_s=0.5) as session:
        run_session(session.source, slow)
    assert slow.taken == 3 and slow.asked == 3 * 3 + 1
