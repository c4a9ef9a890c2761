"""Which stick and button means what; one mapping serves pygame's joysticks and ROS's ``/joy``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ursnav_torch.devices.base import OperatorInput, Stamp
from ursnav_torch.errors import InputError

AXES = ("bend_x", "bend_y", "insertion", "light")
BUTTONS = (
    "forward", "back", "dead_man", "light_up", "light_down", "arm", "acknowledge", "snapshot", "quit", "emergency_stop",
)  # fmt: skip

#: Axes that move the scope.
DRIVING = ("bend_x", "bend_y", "insertion")
#: A first report farther from rest than this is a trigger that was let go, not a stick that is being moved.
JUMP = 0.5


def _default_axes() -> dict[str, tuple[int, float]]:
    return {"bend_x": (0, 1.0), "bend_y": (1, 1.0), "light": (7, 1.0)}


def _default_buttons() -> dict[str, int]:
    names = ("dead_man", "emergency_stop", "snapshot", "forward", "back", "acknowledge", "arm", "quit")
    return dict(zip(names, (0, 1, 2, 4, 5, 6, 7, 8), strict=True))


@dataclass(frozen=True, slots=True)
class GamepadMapping:
    """Sticks and buttons by number; the numbers are those of an Xbox pad on Linux.

    As in the thesis, the stick's left and right turn the tip about x, up and down about y, L drives forward and R
    back. A joystick's hats count as further axes after its own (x, then y).

    Args:
        axes: for ``bend_x``, ``bend_y``, ``insertion``, ``light`` the axis and a factor, -1 to turn it round.
        buttons: for ``forward``, ``back``, ``dead_man``, ``light_up``, ``light_down``, ``arm``, ``acknowledge``,
            ``snapshot``, ``quit``, ``emergency_stop`` the button.
        dead_zone: a stick's travel that counts as nothing, 0 to less than 1.

    Raises:
        InputError: a name is not among these, there is no ``dead_man`` or no ``emergency_stop``, or the dead zone is
            out of range.
    """

    axes: Mapping[str, tuple[int, float]] = field(default_factory=_default_axes)
    buttons: Mapping[str, int] = field(default_factory=_default_buttons)
    dead_zone: float = 0.08

    def __post_init__(self) -> None:
        for given, known in ((self.axes, AXES), (self.buttons, BUTTONS)):
            if unknown := sorted(given.keys() - set(known)):
                raise InputError(f"Gamepad mapping: {unknown} mean nothing; known are {', '.join(known)}.")
        if missing := {"dead_man", "emergency_stop"} - self.buttons.keys():
            raise InputError(f"Gamepad mapping: {sorted(missing)} must have a button.")
        if not 0 <= self.dead_zone < 1:
            raise InputError(f"Gamepad mapping: dead_zone must be 0 to less than 1, got {self.dead_zone}.")


class MappedInput:
    """Turns raw axes and buttons into the operator's wishes, and remembers which buttons were up.

    An analog trigger rests at -1, which would mean full speed back: an axis drives only if it was at rest with the dead
    man's button released. Drivers say 0 of an axis until it first moves, so one whose first word is a jump does not
    drive either until it was seen at rest. An axis that was not reported begins anew: silence is not rest.
    A button that is held when it is first heard of, or heard of again, was not pressed.
    """

    def __init__(self, mapping: GamepadMapping) -> None:
        self._mapping = mapping
        self._up: set[str] = set()  # buttons that were reported, and not held
        self._light = 0
        self._fit: set[str] = set()
        self._spoken: set[str] = set()

    def __call__(self, stamp: Stamp, axes: Sequence[float], buttons: Sequence[int]) -> OperatorInput:
        """The operator's input of this moment; axes that are not reported drive nothing, buttons are up."""
        told = {name: bool(buttons[n]) for name, n in self._mapping.buttons.items() if n < len(buttons)}
        down = {name for name, held in told.items() if held}
        went_down, self._up = down & self._up, set(told) - down
        light = round(self._axis("light", axes))
        light_step = ("light_up" in went_down) - ("light_down" in went_down) + (light if light != self._light else 0)
        self._light = light
        self._watch_axes(axes, "dead_man" in down)
        drive = self._driving("insertion", axes) + ("forward" in down) - ("back" in down)
        return OperatorInput(
            stamp,
            bend_x=self._driving("bend_x", axes),
            bend_y=self._driving("bend_y", axes),
            insertion=min(max(drive, -1.0), 1.0),
            dead_man="dead_man" in down,
            light_step=min(max(light_step, -1), 1),
            arm="arm" in went_down,
            acknowledge="acknowledge" in went_down,
            snapshot="snapshot" in went_down,
            quit="quit" in went_down,
            emergency_stop="emergency_stop" in down,
        )

    def _watch_axes(self, axes: Sequence[float], dead_man: bool) -> None:
        """Learn which axes are at rest; only with the dead man's button released can one become fit to drive."""
        for name in DRIVING:
            number, _ = self._mapping.axes.get(name, (-1, 0.0))
            if not 0 <= number < len(axes):
                self._fit.discard(name)
                self._spoken.discard(name)
                continue
            value = axes[number]
            at_rest = past_dead_zone(value, self._mapping.dead_zone) == 0.0
            first_word = name not in self._spoken and value != 0.0
            if value != 0.0:
                self._spoken.add(name)
            if at_rest and not dead_man:
                self._fit.add(name)
            elif not dead_man or (first_word and abs(value) > JUMP):
                self._fit.discard(name)

    def _driving(self, name: str, axes: Sequence[float]) -> float:
        """An axis that may drive: it was at rest when the dead man's button went down."""
        return self._axis(name, axes) if name in self._fit else 0.0

    def _axis(self, name: str, axes: Sequence[float]) -> float:
        number, factor = self._mapping.axes.get(name, (-1, 0.0))
        value = axes[number] if 0 <= number < len(axes) else 0.0
        return past_dead_zone(value, self._mapping.dead_zone) * factor


def past_dead_zone(value: float, dead_zone: float) -> float:
    """A stick's deflection in -1..1, zero inside the dead zone and rising from zero at its rim."""
    size = min(abs(value), 1.0)
    if not size > dead_zone:  # also for nan
        return 0.0
    return (size - dead_zone) / (1 - dead_zone) * (1 if value > 0 else -1)
