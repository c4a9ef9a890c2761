"""What a page may ask for: commands by name, each with one value of a known type, inside its bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from ursnav_torch.errors import InputError
from ursnav_torch.records import to_record

#: No message of ours is longer, and no place, angle, count or time on a page is farther from zero.
MOST_BYTES, MOST_TEXT, LARGEST = 4096, 40, 1e6
#: How a page begins to say that it has shown a message.
SHOWN = '{"shown":'


@dataclass(frozen=True, slots=True)
class Command:
    """One thing that can be asked for.

    Attributes:
        do: what is done, with the value, or without one where ``kind`` is None.
        kind: the value's type.
        low, high: bounds of a number.
        choices: what a text may be; None for any of 1 to 40 characters.
        overtakes: it waits for no command before it, and those that wait are forgotten.
    """

    do: Callable[..., object]
    kind: Any = None
    low: float = -LARGEST
    high: float = LARGEST
    choices: tuple[str, ...] | None = None
    overtakes: bool = False

    def run(self, value: Any) -> None:
        """Check the value and do it.

        Raises:
            InputError: the value is of another kind or out of bounds; or what `do` raises.
        """
        if self.kind is None:
            self.do()
            return
        value = to_record(value, self.kind, "The command's value")
        parts: tuple[Any, ...] = value if isinstance(value, tuple) else (value,)
        if any(isinstance(n, float) and not math.isfinite(n) for n in parts):
            raise InputError("The command's value is no finite number.")
        if any(isinstance(n, (int, float)) and not self.low <= n <= self.high for n in parts):
            raise InputError(f"The command's value {value} is not within {self.low:g} and {self.high:g}.")
        texts = [part for part in parts if isinstance(part, str)]
        if not all(text in self.choices if self.choices else 0 < len(text) <= MOST_TEXT for text in texts):
            raise InputError(f"The command's value {str(value)[:MOST_TEXT]!r} is none of those offered.")
        self.do(value)


def shown_kind(raw: str) -> str | None:
    """The kind of message that a page says it has shown, ``{"shown": KIND}``; None where it says something else."""
    return _text_at("shown", raw) if raw.startswith(SHOWN) else None


def does_overtake(raw: str, commands: Mapping[str, Command]) -> bool:
    """Whether a message asks for a command that waits for no other."""
    command = commands.get(_text_at("do", raw) or "")
    return command is not None and command.overtakes


def _text_at(key: str, raw: str) -> str | None:
    """The text that a message has at a key; None where it has none or is no message of a page."""
    try:
        message = msgspec.json.decode(raw) if len(raw) <= MOST_BYTES else None
    except (msgspec.DecodeError, RecursionError):
        return None
    text = message.get(key) if isinstance(message, dict) else None
    return text if isinstance(text, str) else None


def run_message(raw: Any, commands: dict[str, Command]) -> None:
    """Do what a message ``{"do": NAME, "value": VALUE}`` asks for.

    Raises:
        InputError: it is no such message, there is no such command, or its value is refused.
        UrsnavError: what was asked for cannot be done.
    """
    if not isinstance(raw, (str, bytes)) or len(raw) > MOST_BYTES:
        raise InputError(f"A message of a page is text of at most {MOST_BYTES} characters.")
    try:
        message = msgspec.json.decode(raw)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise InputError("A message of a page is JSON.") from None
    name = message.get("do") if isinstance(message, dict) else None
    if not isinstance(name, str) or name not in commands:
        raise InputError(f"There is no such command; there are {', '.join(commands)}.")
    commands[name].run(message.get("value"))
