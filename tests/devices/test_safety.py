"""Caps, limits and the gate: invariants of what may be sent."""

import math

import numpy as np
import pytest
from dialogue import wait_until
from hypothesis import given
from hypothesis import strategies as st

from ursnav_torch.devices import GrblRobot, JointRates, Joints, Limits, Robot, SafetyGate, clamp_rates
from ursnav_torch.errors import DeviceTimeoutError, InputError

LIMITS = Limits()
H = 0.12
any_rate = st.floats(-1e6, 1e6)
rates = st.builds(JointRates, any_rate, any_rate, any_rate)
inside = st.builds(Joints, st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.floats(0, LIMITS.max_insertion_mm))


@given(rates, inside)
def test_what_is_sent_keeps_caps_and_limits(wanted, joints):
    sent = clamp_rates(wanted, joints, LIMITS, H)
    assert math.hypot(sent.bend_x_rad_s, sent.bend_y_rad_s) <= LIMITS.max_bend_rate_rad_s * (1 + 1e-9)
    assert abs(sent.insertion_mm_s) <= LIMITS.max_insertion_rate_mm_s
    bend = math.hypot(joints.bend_x_rad + sent.bend_x_rad_s * H, joints.bend_y_rad + sent.bend_y_rad_s * H)
    assert bend <= LIMITS.max_bend_rad * (1 + 1e-9)
    assert -1e-9 <= joints.insertion_mm + sent.insertion_mm_s * H <= LIMITS.max_insertion_mm + 1e-9


@given(inside)
def test_small_wishes_well_inside_are_not_touched(joints):
    wanted = JointRates(0.01, -0.02, 0.5)
    if math.hypot(joints.bend_x_rad, joints.bend_y_rad) < 2.0 and 1 < joints.insertion_mm < 119:
        assert clamp_rates(wanted, joints, LIMITS, H) == wanted


@given(st.floats(-math.pi, math.pi), st.floats(1.0, 2.0))
def test_outside_the_limit_the_bend_never_grows_and_may_shrink(direction, factor):
    size = LIMITS.max_bend_rad * factor
    joints = Joints(size * math.cos(direction), size * math.sin(direction), 10.0)
    out = JointRates(0.5 * math.cos(direction), 0.5 * math.sin(direction), 0.0)
    sent = clamp_rates(out, joints, LIMITS, H)
    ahead = math.hypot(joints.bend_x_rad + sent.bend_x_rad_s * H, joints.bend_y_rad + sent.bend_y_rad_s * H)
    assert ahead <= size * (1 + 1e-9)
    back = JointRates(-out.bend_x_rad_s, -out.bend_y_rad_s, 0.0)
    assert clamp_rates(back, joints, LIMITS, H) == back


def test_a_slider_beyond_its_end_may_only_come_back():
    beyond = Joints(insertion_mm=LIMITS.max_insertion_mm + 5)
    assert clamp_rates(JointRates(insertion_mm_s=3), beyond, LIMITS, H).insertion_mm_s == 0
    assert clamp_rates(JointRates(insertion_mm_s=-3), beyond, LIMITS, H).insertion_mm_s == -3


@given(rates, inside, st.builds(Joints, st.floats(0, 0.3), st.floats(0, 0.3), st.floats(0, 5)), st.floats(-1, 1))
def test_wherever_within_its_slack_the_robot_stands_limits_are_kept_or_approached(wanted, joints, slack, share):
    sent = clamp_rates(wanted, joints, LIMITS, H, slack)
    true = joints.insertion_mm + share * slack.insertion_mm
    end = true + sent.insertion_mm_s * H
    assert min(true, 0.0) - 1e-9 <= end <= max(true, LIMITS.max_insertion_mm) + 1e-9
    bend = math.hypot(joints.bend_x_rad + sent.bend_x_rad_s * H, joints.bend_y_rad + sent.bend_y_rad_s * H)
    room = LIMITS.max_bend_rad - math.hypot(slack.bend_x_rad, slack.bend_y_rad)
    assert bend <= max(room, math.hypot(joints.bend_x_rad, joints.bend_y_rad)) + 1e-9


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_move_nothing(bad):
    assert clamp_rates(JointRates(bad, bad, bad), Joints(0.1, 0.1, 5.0), LIMITS, H).is_zero


def test_impossible_limits_and_times_are_refused():
    with pytest.raises(InputError, match="max_bend_rad must be positive"):
        Limits(max_bend_rad=0)
    with pytest.raises(InputError, match=r"between 0 and 0\.15"):
        GrblRobot("x", horizon_s=0.5)
    with pytest.raises(InputError, match="watchdog_s"):
        GrblRobot("x", watchdog_s=0.6)


def test_the_gate_starts_disarmed_and_a_stop_must_be_acknowledged():
    gate = SafetyGate()
    assert gate.refusal(dead_man=True) == "disarmed: not armed yet"
    assert gate.arm()
    assert gate.refusal(dead_man=False) == "dead-man button not held"
    assert gate.refusal(dead_man=True) == ""
    gate.emergency_stop("first")
    gate.emergency_stop("second")
    assert gate.refusal(dead_man=True) == "stopped: first"
    gate.disarm()
    assert not gate.arm() and gate.state == "stopped"
    gate.acknowledge()
    assert gate.state == "disarmed" and gate.arm()


class ToyRobot(Robot):
    """The smallest robot: remembers what it was told."""

    def __init__(self, **settings):
        super().__init__(LIMITS, 0.1, 0.2, 0.01)
        self.told, self.failing = [], False

    def _open(self): ...
    def _close(self): ...
    def set_light(self, level):
        return level

    def _joints_of(self, axes):
        return Joints(*axes)

    def _axes_of(self, joints):
        return np.array([joints.bend_x_rad, joints.bend_y_rad, joints.insertion_mm])

    def _joints_ahead(self):
        return Joints(insertion_mm=50.0)

    def _send(self, rates):
        if self.failing:
            raise DeviceTimeoutError("silent")
        self.told.append(rates)
        return rates

    def _halt(self):
        self.told.append("halt")

    def _kill(self):
        self.told.append("kill")

    def _recover(self):
        self.told.append("recover")

    def _recount(self, axes):
        self.told.append("recount")

    def _read_axes(self, timeout_s):
        return False


def test_every_robot_obeys_gate_watchdog_and_faults():
    forward = JointRates(insertion_mm_s=2.0)
    robot = ToyRobot()
    robot.stop()
    robot.emergency_stop("before it was even connected")
    assert robot.told == []
    robot.gate.acknowledge()
    with robot:
        assert robot.command(forward, True).sent.is_zero
        robot.arm()
        assert robot.command(JointRates(insertion_mm_s=100.0), True).sent.insertion_mm_s == 8.0
        assert robot.command(JointRates(insertion_mm_s=100.0), True).reason == "limit"
        assert robot.command(forward, False).reason == "dead-man button not held"
        assert robot.told[-1] == "halt"  # letting go stops at once
        robot.command(forward, True)
        assert wait_until(lambda: robot.gate.state == "disarmed") and robot.told[-1] == "halt"
        robot.arm()
        robot.failing = True
        with pytest.raises(DeviceTimeoutError):
            robot.command(forward, True)
        assert robot.told[-1] == "kill" and robot.gate.state == "stopped"
        assert robot.command(forward, True).reason == "stopped: DeviceTimeoutError: silent"
        robot.acknowledge()
        assert robot.told[-1] == "recover"
        robot.place.lose("the board was reset")
        assert not robot.arm() and "the board was reset" in robot.why_not_armed
        robot.acknowledge()
        assert not robot.arm()  # only a word on where it stands helps
        robot.confirm_place()
        assert robot.told[-1] == "recount" and robot.arm()
        robot.stop()
        robot.stop()
    robot.stop()
    assert not robot.is_connected and robot.gate.state == "disarmed"


class OvertakenRobot(ToyRobot):
    """A stop by another thread comes while a command is on its way to the controller."""

    def __init__(self, overtake, **settings):
        super().__init__(**settings)
        self._overtake = overtake

    def _send(self, rates):
        sent = super()._send(rates)
        self._overtake(self)
        return sent


@pytest.mark.parametrize(
    ("overtake", "last"), [(lambda r: r.emergency_stop("now"), "kill"), (lambda r: r.disarm(), "halt")]
)
def test_a_stop_that_a_command_may_have_overtaken_is_said_once_more(overtake, last):
    """The controller may have got the stop first, and then the motion: it must hear the stop last."""
    forward = JointRates(insertion_mm_s=2.0)
    with OvertakenRobot(overtake) as robot:
        robot.arm()
        robot.command(forward, True)
        assert robot.told == [forward, last, last]
        robot.told.clear()
        assert robot.command(forward, True).sent.is_zero and forward not in robot.told


def test_a_link_that_fails_after_a_stop_reports_the_stop():
    def stop_and_fail(robot):
        robot.emergency_stop("now")
        raise DeviceTimeoutError("silent")

    with OvertakenRobot(stop_and_fail) as robot:
        robot.arm()
        sample = robot.command(JointRates(insertion_mm_s=2.0), True)
        assert sample.sent.is_zero and sample.reason == "stopped: now"
