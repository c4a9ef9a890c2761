"""Rigs: everything is connected and disconnected together; hands become motion, light and stops."""

import time
from functools import partial

import numpy as np
import pytest
from dialogue import wait_until

from ursnav_torch.devices import CommandSample, Gamepad, GrblRobot, Note, OperatorInput, RobotLight, RosserialRobot
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError, InputError
from ursnav_torch.geometry import transform_from
from ursnav_torch.session import Control, Rig, build_rig
from ursnav_torch.session.open import open_session
from ursnav_torch.simulation import (
    SimulatedGrblRobot,
    SimulatedNdiTracker,
    SimulatedOpenIgtlTracker,
    SimulatedRosserialRobot,
    SteppedRobot,
    Twin,
    TwinCamera,
    TwinPilot,
    World,
)
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.port import SimulatedPort


def open_space(points):
    return np.full(len(points), 100.0)


def picture(T):
    return np.full((4, 4), 100, np.uint8)


class Hands(Gamepad):
    """What a test's operator does."""

    def __init__(self):
        super().__init__()
        self.now = {}
        self.failing = None

    def _open(self): ...
    def _close(self): ...
    def read(self):
        if self.failing:
            raise self.failing
        now, self.now = self.now, {k: v for k, v in self.now.items() if k not in ("arm", "acknowledge", "light_step")}
        return OperatorInput(self._stamp(), **now)


def make_rig(robot=SimulatedGrblRobot, tracker=SimulatedNdiTracker, hands=None):
    return build_rig(
        camera=partial(TwinCamera, rate_hz=50.0),
        tracker=partial(tracker),
        robot=partial(robot),
        light=partial(RobotLight),
        gamepad=hands or Hands(),
        twin=lambda world: Twin(open_space, picture, transform_from(np.eye(3), [0.0, 0.0, 0.0])),
        world=lambda: World(None, None),
    )


def drain(tracker):
    """Read what has piled up, and on for half a second; a busy machine delays the newest."""
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        tracker.read()


@pytest.mark.parametrize("robot", [SimulatedGrblRobot, SimulatedRosserialRobot])
@pytest.mark.parametrize("tracker", [SimulatedNdiTracker, SimulatedOpenIgtlTracker])
def test_through_any_drivers_hands_move_the_twin_and_every_device_sees_it(robot, tracker):
    hands = Hands()
    with make_rig(robot, tracker, hands) as rig:
        control = Control(rig.robot, hands, rig.light)
        before = np.array(rig.tracker.read().position_mm)
        hands.now = {"arm": True, "insertion": 1.0, "dead_man": True}
        start = time.monotonic()

        def driven():
            control.step()
            return rig.twin.pose()[2, 3] > 4.8

        assert wait_until(driven)  # a machine that is late only takes longer
        rig.robot.stop()
        assert rig.twin.pose()[2, 3] < 8.0 * (time.monotonic() - start) + 0.5  # full speed is 8 mm/s
        assert wait_until(lambda: abs(rig.robot.read().joints.insertion_mm - rig.twin.pose()[2, 3]) < 0.25)
        drain(rig.tracker)
        moved = np.mean([rig.tracker.read().position_mm for _ in range(10)], axis=0) - before
        assert np.linalg.norm(moved) == pytest.approx(rig.twin.pose()[2, 3], abs=2.5)  # noise of one sample and ten
        bright = rig.camera.read().image.mean()
        hands.now = {"light_step": -1}
        control.step()
        assert wait_until(lambda: rig.camera.read().image.mean() < bright)


def test_stop_button_dead_man_and_acknowledgment_work_through_the_control_cycle():
    hands = Hands()
    with make_rig(hands=hands) as rig:
        control = Control(rig.robot, hands)

        def cycle(**now):
            hands.now = now
            (command,) = (e for e in control.step() if isinstance(e, CommandSample))
            return command

        push = {"insertion": 0.5, "dead_man": True}
        assert cycle(**push).reason.startswith("disarmed")
        assert not cycle(arm=True, **push).sent.is_zero
        assert cycle(insertion=0.5).reason == "dead-man button not held"
        assert cycle(emergency_stop=True, **push).reason == "stopped: operator"
        assert cycle(arm=True, **push).sent.is_zero
        assert cycle(acknowledge=True, **push).sent.is_zero
        assert not cycle(arm=True, **push).sent.is_zero


def test_a_stop_is_heard_in_the_cycle_in_which_the_lamp_fails():
    class DeadLamp(RobotLight):
        def set_level(self, level):
            raise DeviceError("the lamp does not answer")

    hands = Hands()
    with make_rig(hands=hands) as rig:
        control = Control(rig.robot, hands, DeadLamp(rig.robot))
        hands.now = {"arm": True}
        control.step()
        assert rig.robot.gate.state == "armed"
        hands.now = {"emergency_stop": True, "light_step": -1}
        events = control.step()
        assert rig.robot.gate.state == "stopped"
        assert "the lamp does not answer" in [e.text for e in events if isinstance(e, Note)]


def test_light_that_a_stop_put_out_comes_back_as_it_was_with_the_acknowledgment():
    hands = Hands()
    with make_rig(SimulatedGrblRobot, hands=hands) as rig:
        control = Control(rig.robot, hands, rig.light)

        def cycle(**now):
            hands.now = now
            control.step()

        def brightness():
            return rig.camera.read().image.mean()

        cycle(light_step=-1)
        time.sleep(0.2)
        lit = brightness()
        cycle(emergency_stop=True)
        assert wait_until(lambda: brightness() < 0.5 * lit)
        cycle(acknowledge=True)
        assert wait_until(lambda: brightness() == pytest.approx(lit, rel=0.05))


def test_a_fault_of_the_robot_is_a_note_and_one_of_the_gamepad_disarms():
    hands = Hands()
    with make_rig(hands=hands) as rig:
        control = Control(rig.robot, hands)
        hands.now = {"arm": True, "insertion": 1.0, "dead_man": True}
        control.step()
        rig.robot.board.answering = False
        time.sleep(0.1)
        (note,) = (e for e in control.step() if isinstance(e, Note))
        assert note.level == "error" and rig.robot.gate.state == "stopped"
        rig.robot.board.answering = True
        hands.now = {"acknowledge": True}
        control.step()
        hands.now = {"arm": True}
        control.step()
        assert rig.robot.gate.state == "armed"
        hands.failing = DeviceNotConnectedError("gone")
        with pytest.raises(DeviceError):
            control.step()
        assert rig.robot.gate.state == "disarmed"


def test_a_rig_that_cannot_connect_leaves_nothing_connected():
    rig = make_rig()
    rig.camera.connect = lambda: (_ for _ in ()).throw(DeviceNotConnectedError("no camera"))
    with pytest.raises(DeviceNotConnectedError, match="no camera"), rig:
        pass
    assert not any(device.is_connected for device in rig.devices())


def test_devices_that_need_what_is_not_there_are_refused():
    with pytest.raises(InputError, match="start from hardware=simulated"):
        build_rig(camera=partial(TwinCamera))
    with pytest.raises(InputError, match="there is no robot"):
        build_rig(light=partial(RobotLight))
    assert build_rig() == Rig()


def test_robots_say_whether_they_are_simulated():
    assert not GrblRobot.simulated and not RosserialRobot.simulated
    assert SimulatedGrblRobot.simulated and SimulatedRosserialRobot.simulated and SteppedRobot.simulated


@pytest.mark.parametrize("simulated", [False, True])
def test_from_the_page_only_a_simulated_robot_moves_whatever_else_is_simulated(simulated):
    port = SimulatedPort(GrblBoard(), period_s=0.002)
    hardware = partial(
        build_rig,
        tracker=partial(SimulatedNdiTracker),
        robot=partial(SimulatedGrblRobot) if simulated else partial(GrblRobot, port.path),
        gamepad=Hands(),
        twin=lambda world: Twin(open_space, picture, transform_from(np.eye(3), [0.0, 0.0, 0.0])),
    )
    try:
        with open_session(hardware, lambda: World(None, None)) as session:
            console = session.controls.console
            console.arm()
            console.drive("forward")
            hands = console.read()
            assert (hands.arm, hands.dead_man, hands.insertion) == (simulated, simulated, float(simulated))
    finally:
        port.close()


@pytest.mark.parametrize("robot", [partial(GrblRobot, "/dev/none"), partial(RosserialRobot, ["/dev/none"])])
def test_the_simulations_pilot_is_refused_a_robot_that_is_not_simulated(robot, phantom):
    twin = Twin(open_space, picture, transform_from(np.eye(3), [0.0, 0.0, 0.0]))
    build = partial(build_rig, gamepad=partial(TwinPilot), twin=lambda world: twin, world=lambda: World(phantom, None))
    with pytest.raises(InputError, match=r"Robot is not simulated.*choose hardware/gamepad=pygame"):
        build(robot=robot)
    assert build().robot is None
    rig = build(robot=partial(SimulatedGrblRobot))
    assert isinstance(rig.gamepad, TwinPilot)
    rig.close()
