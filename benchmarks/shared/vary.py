"""One setting in several values: what ``vary=NAME=VALUE,VALUE`` of a suite asks for."""

from dataclasses import fields, replace
from typing import Any, TypeVar

from ursnav_torch.errors import InputError

Settings = TypeVar("Settings", bound=Any)


def named_values(vary: str) -> tuple[str, list[str]]:
    """The name and the values of ``NAME=VALUE,VALUE``.

    Raises:
        InputError: it is no such text.
    """
    name, _, values = vary.partition("=")
    if not name or not values:
        raise InputError(f"vary={vary} names no setting and its values; give vary=NAME=VALUE,VALUE.")
    return name, values.split(",")


def with_value(settings: Settings, name: str, value: str) -> Settings:
    """A settings dataclass with one of its numbers or yes-or-noes read from a text.

    Raises:
        InputError: it has no setting of that name, or the value is none of the setting's kind.
    """
    known = [f.name for f in fields(settings)]
    if name not in known:
        raise InputError(f"{name!r} is no setting of {type(settings).__name__}; those are {', '.join(known)}.")
    now = getattr(settings, name)
    try:
        read = {"true": True, "false": False}[value.lower()] if isinstance(now, bool) else type(now)(value)
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{value!r} is no value of {name}, which is {now} now.") from None
    return replace(settings, **{name: read})
