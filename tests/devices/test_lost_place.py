"""A controller that was reset: the place is unknown until the operator says, and the limits hold for the true one."""

import os
import random
import time

import numpy as np
import pytest
from dialogue import wait_until

from ursnav_torch.devices import GrblRobot, JointRates, Joints, Limits, RosserialRobot
from ursnav_torch.devices.robots.place import Place
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.port import SimulatedPort
from ursnav_torch.simulation.rosserial_board import RosserialBoard

LIMITS = Limits(max_insertion_mm=6.0)


class Bench:
    """A board on a port, its robot, and where the motors truly stand, whatever the board counts."""

    def __init__(self, kind):
        self.grbl = kind == "grbl"
        self.board = GrblBoard() if self.grbl else RosserialBoard()
        self.port = SimulatedPort(self.board, period_s=0.002)
        ports = self.port.path if self.grbl else [self.port.path]
        self.robot = (GrblRobot if self.grbl else RosserialRobot)(ports, limits=LIMITS)
        self.robot.connect()
        self.forgotten = 0.0

    def counted(self):
        return float(self.board.axes_mm()[2] if self.grbl else self.board.steps()[2] / 400)

    def true(self):
        return self.forgotten + self.counted()

    def reset(self, heard=True):
        """The board starts anew, in mid-motion or not; its greeting may be lost on the line."""
        with self.board._lock:
            self.forgotten = self.true()
            greeting = self.board.power_cycle() if self.grbl else self.board.restart()
            if not (heard or self.grbl):
                self.board._announced = False  # an Arduino that nobody asked anew for its topics is silent
        if heard:
            os.write(self.port._master, greeting)

    def drive(self, rate, seconds):
        end, cycle = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            cycle += 1
            try:
                self.robot.command(JointRates(insertion_mm_s=rate), True)
                if cycle % 5 == 0:
                    self.robot.read()
            except DeviceError:
                return
            time.sleep(0.02)

    def rest(self):
        self.robot.stop()
        assert wait_until(lambda: not self.board.moving, 1.0)
        time.sleep(0.25)

    def close(self):
        self.robot.disconnect()
        self.port.close()


@pytest.fixture(params=["grbl", "rosserial"])
def bench(request):
    bench = Bench(request.param)
    yield bench
    bench.close()


def read_until_stopped(robot):
    def stopped():
        try:
            robot.read()
        except DeviceError:
            pass
        return robot.gate.state == "stopped"

    assert wait_until(stopped, 1.0)


def test_a_reset_while_standing_loses_the_place_and_a_word_of_the_operator_finds_it(bench):
    robot = bench.robot
    robot.arm()
    bench.drive(8.0, 0.5)
    bench.rest()
    at = robot.read().joints.insertion_mm
    assert at == pytest.approx(bench.true(), abs=0.01) and at > 2.0
    bench.reset()
    read_until_stopped(robot)
    for _ in range(3):  # reading on while stopped overwrites nothing
        try:
            sample = robot.read()
        except DeviceError:
            continue
        assert (sample.joints.insertion_mm, sample.place_known) == (at, False)
    robot.acknowledge()
    assert robot.gate.state == "disarmed" and not robot.arm()
    assert f"last certain {at:.1f} mm in" in robot.why_not_armed and "acknowledge once more" in robot.why_not_armed
    robot.confirm_place()
    assert robot.why_not_armed == "" and robot.arm()
    sample = robot.read()
    assert sample.place_known and sample.joints.insertion_mm == pytest.approx(bench.true(), abs=0.01)
    bench.drive(8.0, 2.5)
    bench.rest()
    assert at + 1.0 < bench.true() <= 6.05
    bench.drive(-8.0, 2.5)
    bench.rest()
    assert -0.05 <= bench.true() < 2.0


def test_the_operator_may_say_where_it_stands(bench):
    robot = bench.robot
    robot.arm()
    bench.drive(8.0, 0.4)
    bench.rest()
    bench.reset()
    read_until_stopped(robot)
    robot.acknowledge()
    robot.set_place(Joints(insertion_mm=1.0))
    assert robot.read().joints.insertion_mm == pytest.approx(1.0, abs=0.01)


def test_a_stop_in_mid_motion_is_no_reset(bench):
    robot = bench.robot
    robot.arm()
    bench.drive(8.0, 0.3)
    robot.emergency_stop("operator")
    assert wait_until(lambda: not bench.board.moving, 0.5)
    time.sleep(0.3)
    robot.acknowledge()
    assert robot.place.is_known and robot.arm()
    assert robot.read().joints.insertion_mm == pytest.approx(bench.true(), abs=0.05)


def test_acknowledging_while_unplugged_says_so(bench):
    robot = bench.robot
    robot.arm()
    bench.drive(8.0, 0.1)
    bench.port.unplug()
    read_until_stopped(robot)
    for _ in range(2):
        with pytest.raises(DeviceNotConnectedError, match="plugged in"):
            robot.acknowledge()
        assert robot.gate.state == "stopped"


@pytest.mark.slow
def test_after_50_random_resets_the_place_is_true_or_unknown_and_the_limits_hold(bench):
    """Resets at rest and in mid-motion; the operator confirms each. Limits are those of the true place."""
    draw, robot, known = random.Random(3), bench.robot, 0
    for _ in range(50):
        robot.arm()
        bench.drive(draw.choice([-8.0, 8.0]), draw.uniform(0.05, 0.4))
        if draw.random() < 0.3:
            bench.rest()
        heard = draw.random() < 0.7
        bench.reset(heard)
        time.sleep(draw.uniform(0.0, 0.1))
        read_until_stopped(robot) if heard else robot.emergency_stop("operator")
        time.sleep(0.1)
        try:
            robot.acknowledge()
            sample = robot.read()
        except DeviceError:
            time.sleep(0.1)
            robot.acknowledge()
            sample = robot.read()
        slack = robot._joints_of(robot.place.slack).insertion_mm
        if sample.place_known:
            known += 1
            assert sample.joints.insertion_mm == pytest.approx(bench.true(), abs=1.8 + slack)
            robot.set_place(Joints(insertion_mm=bench.true()))
        else:
            assert not robot.arm()
            robot.confirm_place()
            slack = robot._joints_of(robot.place.slack).insertion_mm
            assert robot.read().joints.insertion_mm == pytest.approx(bench.true(), abs=slack + 0.05)
        if slack > 1.0:
            robot.set_place(Joints(insertion_mm=bench.true()))
        assert -0.05 <= bench.true() <= 6.05
    print(f"{known} of 50 resets left the place known")


def test_what_is_sent_and_not_reported_makes_the_slack():
    place = Place(0.01)
    place.set(np.zeros(3))
    place.sent(np.array([0.0, 0.0, 2.0]))
    assert place.check(np.array([0, 0, 1.5])) and place.report(np.array([0, 0, 1.0]), np.array([0, 0, 2.0]))
    assert not place.report(np.zeros(3), np.zeros(3)) and not place.is_known
    np.testing.assert_array_equal(place.axes, [0, 0, 1.5])
    place.confirm()
    np.testing.assert_array_equal(place.slack, [0, 0, 0.5])
    assert place.is_known and place.report(np.array([0, 0, 1.5]), np.array([0, 0, 1.5]))
    np.testing.assert_array_equal(place.slack, [0, 0, 0.5])
