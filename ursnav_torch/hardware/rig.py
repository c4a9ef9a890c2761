"""The devices of one set-up, and the cycle that turns the operator's hands into motion and light."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType
from typing import Any, Self

from ursnav_torch.errors import DeviceError, InputError
from ursnav_torch.hardware.base import (
    Camera,
    CommandSample,
    Device,
    Gamepad,
    JointRates,
    Light,
    LightSample,
    Note,
    OperatorInput,
    Output,
    RobotSample,
    Stamper,
    Tracker,
)
from ursnav_torch.hardware.robot import Robot
from ursnav_torch.hardware.safety import STOPPED
from ursnav_torch.hardware.twin import Twin
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import Renderer


@dataclass(frozen=True, slots=True)
class Rig:
    """A set-up; what it lacks is None. In a ``with`` block all of it is connected, and disconnected at the end."""

    camera: Camera | None = None
    tracker: Tracker | None = None
    robot: Robot | None = None
    light: Light | None = None
    gamepad: Gamepad | None = None
    output: Output | None = None
    twin: Twin | None = None

    def devices(self) -> list[Device]:
        """All devices, the robot first."""
        found = (self.robot, self.light, self.gamepad, self.tracker, self.camera, self.output)
        return [device for device in found if device is not None]

    def __enter__(self) -> Self:
        try:
            for device in self.devices():
                device.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the robot, then disconnect everything for good, whatever state it is in."""
        for device in self.devices():
            device.stop()
        for device in reversed(self.devices()):
            with contextlib.suppress(DeviceError):
                device.dispose()


class RobotLight(Light):
    """The LED on the robot's own controller; connected as long as the robot is.

    Raises:
        InputError: there is no robot.
    """

    def __init__(self, robot: Robot | None) -> None:
        super().__init__()
        if robot is None:
            raise InputError("The light hangs on the robot's controller, but there is no robot; choose another light.")
        self.robot = robot

    def set_level(self, level: float) -> LightSample:
        """Dim through the controller; motion may pause for it."""
        self._check_connected()
        return LightSample(self._stamp(), self.robot.set_light(level))

    def _open(self) -> None:
        self.robot.connect()

    def _close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class World:
    """What a twin lives in: the anatomy and what draws it through the scope's lens."""

    kidney: Kidney
    renderer: Renderer


#: Stands, in a ``functools.partial`` of a device, for what the rig fills in; ``null`` in a config.
LATER: Any = None
#: A device, a ``functools.partial`` of one's class that lacks what only the rig knows, or nothing (None or empty).
Choice = Any


def build_rig(
    camera: Choice = None,
    tracker: Choice = None,
    robot: Choice = None,
    light: Choice = None,
    gamepad: Choice = None,
    output: Choice = None,
    twin: Callable[[World], Twin] | None = None,
    world: Callable[[], World] | None = None,
) -> Rig:
    """Put a rig together.

    Args:
        camera, tracker, robot, light, gamepad, output: devices. A partial is given what it holds as `LATER` under the
            names ``twin``, ``robot`` and ``kidney``.
        twin: makes the digital twin; called only when a device asks for it.
        world: makes the anatomy for the twin; called only then.

    Raises:
        InputError: a simulated device is asked for where there is no twin or no world.
    """
    choices = (camera, tracker, robot, light, gamepad)
    simulated = any(isinstance(c, partial) and "twin" in c.keywords and c.keywords["twin"] is None for c in choices)
    if not simulated:
        the_world, the_twin = None, None
    elif twin is None or world is None:
        raise InputError("A simulated device needs a twin and a kidney to be in; start from hardware=simulated.")
    else:
        the_world = world()
        the_twin = twin(the_world)
    known: dict[str, Any] = {"twin": the_twin, "kidney": the_world and the_world.kidney}
    the_robot = _make(robot, known)
    known["robot"] = the_robot
    return Rig(
        camera=_make(camera, known),
        tracker=_make(tracker, known),
        robot=the_robot,
        light=_make(light, known),
        gamepad=_make(gamepad, known),
        output=_make(output, known),
        twin=the_twin,
    )


def _make(choice: Choice, known: Mapping[str, Any]) -> Any:
    if not isinstance(choice, partial):
        return choice or None
    return choice(**{name: known[name] for name, value in choice.keywords.items() if value is None and name in known})


class Control:
    """One cycle of driving: hands in, motion and light out; call `step` 50 times a second.

    Args:
        robot: what moves; None drives nothing.
        gamepad: what the operator holds.
        light: what is dimmed, or None.
        light_step: what one press of the light's buttons changes.
    """

    def __init__(
        self, robot: Robot | None, gamepad: Gamepad, light: Light | None = None, light_step: float = 0.1
    ) -> None:
        self.robot, self.gamepad, self.light, self.light_step = robot, gamepad, light, light_step
        self._level = 1.0
        self._last: OperatorInput | None = None
        self._note = Stamper()
        self._cycle = 0

    def step(self) -> list[OperatorInput | CommandSample | LightSample | RobotSample | Note]:
        """Read the operator's hands once and act; every fifth time also ask the robot where it stands.

        Returns:
            What happened: the operator's input when it changed, the command as sent, and notes on faults; the robot
            stops itself at a fault and waits for the operator's acknowledgment.

        Raises:
            DeviceError: the input device failed; the robot was stopped and disarmed.
        """
        try:
            hands = self.gamepad.read()
        except DeviceError:
            if self.robot:
                self.robot.disarm()
            raise
        events: list[Any] = []
        if self._last is None or replace(hands, stamp=self._last.stamp) != self._last:
            events.append(hands)
        self._last = hands
        self._cycle += 1
        try:
            events += self._light(hands)
            events += self._drive(hands)
        except DeviceError as error:
            events.append(Note(self._note(), "error", str(error)))
        return events

    def _drive(self, hands: OperatorInput) -> list[Any]:
        if self.robot is None:
            return []
        events: list[Any] = []
        if hands.emergency_stop:
            self.robot.emergency_stop("operator")
        elif hands.acknowledge:
            events += self._acknowledge(self.robot)
        elif hands.arm:
            self.robot.arm()
        bend, push = self.robot.limits.max_bend_rate_rad_s, self.robot.limits.max_insertion_rate_mm_s
        wanted = JointRates(hands.bend_x * bend, hands.bend_y * bend, hands.insertion * push)
        events.append(self.robot.command(wanted, hands.dead_man))
        if self._cycle % 5 == 0:
            events.append(self.robot.read())
        return events

    def _acknowledge(self, robot: Robot) -> list[Any]:
        """End a stop; the light, which a controller puts out with the motors, comes back as it was."""
        stopped = robot.gate.state == STOPPED
        robot.acknowledge()
        if self.light is None or not stopped or robot.gate.state == STOPPED:
            return []
        return [self.light.set_level(self._level)]

    def _light(self, hands: OperatorInput) -> list[Any]:
        if self.light is None or (hands.light_step == 0 and self._cycle > 1):
            return []
        self._level = min(max(self._level + hands.light_step * self.light_step, 0.0), 1.0)
        return [self.light.set_level(self._level)]
