"""The devices of one set-up."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Self

from ursnav_torch.devices import (
    Camera,
    Device,
    Gamepad,
    Light,
    Output,
    Robot,
    Tracker,
)
from ursnav_torch.errors import DeviceError, InputError
from ursnav_torch.simulation import Twin, World


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
