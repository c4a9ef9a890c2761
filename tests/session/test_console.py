"""Hands on a page."""

import time

from ursnav_torch.devices import Gamepad, OperatorInput, SafetyGate
from ursnav_torch.session import HOLD, Console
from ursnav_torch.simulation import TwinPilot


class Hands(Gamepad):
    def __init__(self, **values):
        super().__init__()
        self.values = values

    def read(self):
        return OperatorInput(self._stamp(), **self.values)

    def _open(self): ...
    def _close(self): ...


class FakeRobot:
    def __init__(self):
        self.stopped = []

    def emergency_stop(self, reason):
        self.stopped.append(reason)


def test_a_press_moves_for_a_moment_only():
    with Console(None, may_drive=True) as console:
        console.drive("forward", hold_s=0.05)
        assert console.read().insertion == 1.0 and console.read().dead_man
        time.sleep(0.06)
        assert console.read().insertion == 0.0 and not console.read().dead_man


def test_a_long_hold_cannot_be_asked_for():
    with Console(None, may_drive=True) as console:
        console.drive("back", hold_s=3600)
        time.sleep(0.4)
        assert not console.read().dead_man


def test_a_real_robot_is_neither_armed_nor_driven_from_a_page_but_stopped_and_acknowledged():
    robot = FakeRobot()
    with Console(Hands(bend_x=0.5, dead_man=True), robot, may_drive=False) as console:
        console.drive("forward")
        console.arm()
        read = console.read()
        assert (read.insertion, read.bend_x, read.arm) == (0.0, 0.5, False)
        console.emergency_stop()
        assert robot.stopped == ["stopped from the page"]
        assert console.read().emergency_stop and not console.read().emergency_stop
        console.acknowledge()
        assert console.read().acknowledge and not console.read().acknowledge


def test_a_stop_on_the_device_counts_while_the_page_drives():
    with Console(Hands(emergency_stop=True), may_drive=True) as console:
        console.drive("forward")
        read = console.read()
        assert read.emergency_stop and read.insertion == 1.0


def test_the_light_is_dimmed_from_a_page_where_it_may_drive():
    with Console(Hands(light_step=1), may_drive=True) as console:
        console.brighten(-1)
        console.brighten(-1)
        assert console.read().light_step == -1 and console.read().light_step == 1
    with Console(None, may_drive=False) as console:
        console.brighten(1)
        assert console.read().light_step == 0


def test_nonsense_from_a_page_moves_nothing():
    with Console(None, may_drive=True) as console:
        console.drive("../../etc/passwd")
        assert not console.read().dead_man


def test_the_button_held_on_a_page_moves_no_stick_and_only_where_the_page_may_drive():
    with Console(None, may_drive=True) as console:
        console.drive(HOLD)
        read = console.read()
        assert read.dead_man and not (read.bend_x or read.bend_y or read.insertion)
        console.release()
        assert not console.read().dead_man
    with Console(None, may_drive=False) as console:
        console.drive(HOLD)
        assert not console.read().dead_man


class FakePilot(TwinPilot):
    def __init__(self):
        Gamepad.__init__(self)
        self.over = False

    def read(self):
        return OperatorInput(self._stamp(), insertion=1.0, dead_man=True, quit=self.over)

    def _open(self): ...


def test_a_pilot_is_armed_again_by_itself_but_not_after_a_stop():
    robot = FakeRobot()
    robot.gate = SafetyGate()
    with Console(FakePilot(), robot, may_drive=True, stay=True) as console:
        assert console.read().arm
        robot.gate.arm()
        assert not console.read().arm and console.read().insertion == 1.0
        console.emergency_stop()
        console.read()
        robot.gate.disarm()  # as after the stop was acknowledged
        read = console.read()
        assert console.by_hand and not read.arm and not read.dead_man
        console.give_to_pilot(True)
        assert console.read().arm and console.read().insertion == 1.0


def test_a_pilot_that_has_finished_leaves_the_scope_to_the_page():
    robot = FakeRobot()
    robot.gate = SafetyGate()
    pilot = FakePilot()
    with Console(pilot, robot, may_drive=True, stay=True) as console:
        pilot.over = True
        assert not console.read().quit and console.by_hand
    with Console(pilot, robot, may_drive=True, stay=False) as console:
        assert console.read().quit
