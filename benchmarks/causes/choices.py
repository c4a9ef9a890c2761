"""Settings of refinement and of localization that are compared with each other."""

from dataclasses import asdict, dataclass, replace

from ursnav_torch.alignment import RefinementSettings
from ursnav_torch.errors import InputError
from ursnav_torch.localization import LocalizationSettings

DEFAULT = "as they are"


@dataclass(frozen=True, slots=True)
class Choice:
    """How a place is decided, and how poses are refined."""

    localization: LocalizationSettings
    alignment: RefinementSettings


def choices(vary: str) -> dict[str, Choice]:
    """Choices by name: of ``NAME=VALUE,VALUE`` one a value, of an empty text the settings as they are.

    Raises:
        InputError: no setting has that name, or a value is none of its kind.
    """
    now = Choice(LocalizationSettings(), RefinementSettings())
    if not vary:
        return {DEFAULT: now}
    name, _, values = vary.partition("=")
    rooms = {"localization": asdict(now.localization), "alignment": asdict(now.alignment)}
    room = next((room for room, known in rooms.items() if name in known), None)
    if room is None or not values:
        known = ", ".join(sorted(key for known in rooms.values() for key in known))
        raise InputError(f"vary={vary} names no setting and its values; give NAME=VALUE,VALUE with one of {known}.")
    found = {}
    for value in values.split(","):
        changed = replace(getattr(now, room), **{name: _read(value, rooms[room][name], name)})
        found[f"{name}={value}"] = replace(now, **{room: changed})
    return found


def _read(value: str, example: bool | int | float, name: str) -> bool | int | float:
    """A value of the kind that an example has."""
    try:
        if isinstance(example, bool):
            return {"true": True, "false": False}[value.lower()]
        return type(example)(value)
    except (KeyError, ValueError):
        raise InputError(f"vary: {value!r} is no value of {name}, which is {example} now.") from None
