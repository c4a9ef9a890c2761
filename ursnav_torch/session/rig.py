"""The devices of one set-up."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from inspect import signature
from types import TracebackType
from typing import Any, Self, get_args

from ursnav_torch.devices import (
    CameraDevice,
    Device,
    EmTracker,
    Gamepad,
    Lamp,
    Output,
    Robot,
)
from ursnav_torch.errors import DeviceError, InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.simulation import SimulatedTime, Twin, TwinPilot, World
from ursnav_torch.threads import share_arenas

#: What a rig gives to its devices, by type.
PROVIDED: tuple[Any, ...] = (Twin, Kidney, Robot)


@dataclass(frozen=True, slots=True)
class Rig:
    """A set-up; what it lacks is None. In a ``with`` block all of it is connected, and disconnected at the end.

    Attributes:
        clock: simulated time, by which all its devices go; None for the world's.
    """

    camera: CameraDevice | None = None
    tracker: EmTracker | None = None
    robot: Robot | None = None
    light: Lamp | None = None
    gamepad: Gamepad | None = None
    output: Output | None = None
    twin: Twin | None = None
    clock: SimulatedTime | None = None

    def devices(self) -> list[Device]:
        """All devices, the robot first."""
        found = (self.robot, self.light, self.gamepad, self.tracker, self.camera, self.output)
        return [device for device in found if device is not None]

    def __enter__(self) -> Self:
        share_arenas()  # before the devices' threads begin
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
        camera, tracker, robot, light, gamepad, output: devices. A partial is given those of its missing arguments whose
            annotation asks for the rig's `Twin`, `Robot` or `Kidney`.
        twin: makes the digital twin; called only when a device asks for it.
        world: makes the anatomy for the twin; called only then.

    Raises:
        InputError: a simulated device is asked for where there is no twin or no world, or the simulation's pilot is to
            drive a robot that is not simulated.
    """
    choices = (camera, tracker, robot, light, gamepad, output)
    parts: dict[type, Any] = {}
    if any(Twin in _wanted(choice).values() for choice in choices):
        if twin is None or world is None:
            raise InputError("A simulated device needs a twin and a kidney to be in; start from hardware=simulated.")
        the_world = world()
        parts = {Twin: twin(the_world), Kidney: the_world.kidney}
    parts[Robot] = _make(robot, parts)
    hands = _make(gamepad, parts)
    _check_hands(hands, parts[Robot])
    return Rig(
        camera=_make(camera, parts),
        tracker=_make(tracker, parts),
        robot=parts[Robot],
        light=_make(light, parts),
        gamepad=hands,
        output=_make(output, parts),
        twin=parts.get(Twin),
    )


def _check_hands(hands: Gamepad | None, robot: Robot | None) -> None:
    """A pilot holds the dead-man button for ever and arms again by itself: nothing real may hang on it."""
    if isinstance(hands, TwinPilot) and robot is not None and not robot.simulated:
        raise InputError(
            f"{type(robot).__name__} is not simulated, and the simulation's pilot must not drive it; choose "
            "hardware/gamepad=pygame (or keyboard, ros, none), or hardware/robot=simulated_grbl."
        )


def _wanted(choice: Choice) -> dict[str, type]:
    """The arguments that a partial lacks and the rig provides, with the types that their annotations ask for."""
    if not isinstance(choice, partial):
        return {}
    asked = {p.name: p.annotation for p in signature(choice.func, eval_str=True).parameters.values()}
    return {
        name: kind
        for name, hint in asked.items()
        for kind in PROVIDED
        if name not in choice.keywords and (kind is hint or kind in get_args(hint))
    }


def _make(choice: Choice, parts: Mapping[type, Any]) -> Any:
    if not isinstance(choice, partial):
        return choice or None
    return choice(**{name: parts.get(kind) for name, kind in _wanted(choice).items()})
