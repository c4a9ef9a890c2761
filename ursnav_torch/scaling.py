"""Lengths in settings are stated for anatomy, at scale 1: the one rule that makes them those of a larger phantom."""

from copy import copy
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, TypeVar

Settings = TypeVar("Settings")

#: Endings of the names of settings that are lengths, speeds and accelerations.
LENGTH_ENDINGS = ("_mm", "_mm_s", "_mm_s2")
#: Metadata of a field that is a length, but of a device.
NO_ANATOMY = MappingProxyType({"of": "device"})


def scaled(settings: Settings, scale: float) -> Settings:
    """Settings, a dataclass, with every length times a kidney's scale; dataclasses inside it likewise.

    A field is a length if its name ends as `LENGTH_ENDINGS` have it, and stays as it is with `NO_ANATOMY`. Nothing is
    checked again: what settings accept is stated at scale 1.

    Raises:
        TypeError: no dataclass.
    """
    if not is_dataclass(settings) or isinstance(settings, type):
        raise TypeError(f"Expected settings, a dataclass, got {type(settings).__name__}.")
    larger = copy(settings)
    for field in fields(settings):
        value: Any = getattr(settings, field.name)
        if is_dataclass(value) and not isinstance(value, type):
            value = scaled(value, scale)
        elif field.name.endswith(LENGTH_ENDINGS) and value is not None and field.metadata != NO_ANATOMY:
            value = tuple(v * scale for v in value) if isinstance(value, tuple) else value * scale
        object.__setattr__(larger, field.name, value)  # frozen, and only just copied
    return larger
