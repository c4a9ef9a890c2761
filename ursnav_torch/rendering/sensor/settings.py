"""What a fault's setting is: a clean value, a documented range and where the range comes from."""

from dataclasses import field, fields
from typing import Any

from ursnav_torch.errors import InputError


def setting(clean: float, low: float, high: float, source: str) -> Any:
    """A dataclass field that defaults to ``clean`` (the fault is absent) and may lie in ``low`` .. ``high``.

    ``source`` says what the setting does, in which unit, and where its range comes from.
    """
    return field(default=clean, metadata={"clean": clean, "low": low, "high": high, "source": source})


def choice(clean: Any, source: str) -> Any:
    """A dataclass field without better or worse: a color, a seed, a direction."""
    return field(default=clean, metadata={"source": source})


def check_settings(group: Any) -> None:
    """Hold every setting of a dataclass against its range.

    Raises:
        InputError: a value lies outside.
    """
    for f in fields(group):
        value = getattr(group, f.name)
        if "low" in f.metadata and not f.metadata["low"] <= value <= f.metadata["high"]:
            raise InputError(
                f"{type(group).__name__}.{f.name}={value} must lie in {f.metadata['low']} .. {f.metadata['high']} "
                f"({f.metadata['source']})."
            )
