"""Settings of refinement and of localization that are compared with each other."""

from dataclasses import dataclass, fields, replace

from benchmarks.shared.vary import named_values, with_value
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
    name, values = named_values(vary)
    for group in ("localization", "alignment"):
        settings = getattr(now, group)
        if hasattr(settings, name):
            return {f"{name}={value}": replace(now, **{group: with_value(settings, name, value)}) for value in values}
    known = ", ".join(f.name for group in (now.localization, now.alignment) for f in fields(group))
    raise InputError(f"{name!r} is no setting of localization or refinement; those are {known}.")
