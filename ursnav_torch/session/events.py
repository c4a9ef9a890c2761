"""The items of a session, and each as a line of JSON and back."""

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

from ursnav_torch.devices import (
    CommandSample,
    Frame,
    LightSample,
    Note,
    OperatorInput,
    RobotSample,
    Stamp,
    TrackerSample,
)
from ursnav_torch.errors import InputError
from ursnav_torch.records import to_record


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What belonged together when the operator pressed the button: picture, EM sample and robot, if there were any."""

    stamp: Stamp
    frame: Frame | None
    tracker: TrackerSample | None
    robot: RobotSample | None


@dataclass(frozen=True, slots=True)
class Result:
    """What was computed from the picture number ``frame``; ``row`` holds plain numbers, texts and booleans."""

    stamp: Stamp
    frame: int
    row: dict[str, Any]


Event = Frame | TrackerSample | RobotSample | CommandSample | LightSample | OperatorInput | Note | Snapshot | Result

KINDS: dict[str, type[Any]] = {
    "frame": Frame,
    "tracker": TrackerSample,
    "robot": RobotSample,
    "command": CommandSample,
    "light": LightSample,
    "input": OperatorInput,
    "note": Note,
    "snapshot": Snapshot,
    "result": Result,
}
NAMES = {kind: name for name, kind in KINDS.items()}
_STAMP = tuple(f.name for f in dataclasses.fields(Stamp))
_NO_PLAIN = ("image", "encoded", "frame")


def to_line(event: Event, **extra: Any) -> str:
    """One line of JSON, without the end of line; pictures are left out, ``extra`` is added.

    Raises:
        ValueError: a number is not finite.
        TypeError: a result's row holds something that JSON does not know.
    """
    plain = {f.name: _plain(getattr(event, f.name)) for f in dataclasses.fields(event) if f.name not in _NO_PLAIN}
    if isinstance(event, Result):
        plain["frame"] = event.frame
    elif isinstance(event, Snapshot):
        plain["frame"] = event.frame.stamp.sequence if event.frame else None
    line = {"kind": NAMES[type(event)]} | plain | extra
    return json.dumps(line, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def from_line(data: dict[str, Any]) -> Event | None:
    """The event of a parsed line, or None where the kind is not known (a record of a newer version) or is a frame's.

    Raises:
        InputError: the line does not hold what its kind needs.
    """
    kind = KINDS.get(data["kind"])
    if kind is None or kind is Frame:
        return None
    if kind is Snapshot:
        tracker, robot = (_sample(name, data.get(name)) for name in ("tracker", "robot"))
        return Snapshot(stamp_of(data), None, tracker, robot)
    event: Event = to_record(data | {"stamp": _named_stamp(data)}, kind, f"A line of kind {data['kind']}")
    return event


def stamp_of(data: dict[str, Any]) -> Stamp:
    """The stamp of a parsed line.

    Raises:
        InputError: there is none, or it does not hold three numbers.
    """
    return to_record(_named_stamp(data), Stamp, "The stamp of a line")


def _named_stamp(data: dict[str, Any]) -> dict[str, Any]:
    """A stamp's list of numbers, by name."""
    stamp = data.get("stamp")
    if not isinstance(stamp, list) or len(stamp) != len(_STAMP):
        raise InputError(f"A stamp is the list [{', '.join(_STAMP)}], got {stamp!r}.")
    return dict(zip(_STAMP, stamp, strict=True))


def _plain(value: Any) -> Any:
    """Plain data; a stamp, which every sample has, is a list to keep the lines short."""
    if isinstance(value, Stamp):
        return list(dataclasses.astuple(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return value


def _sample(name: str, data: Any) -> Any:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise InputError(f"A snapshot's {name} is an object or null, got {data!r}.")
    return from_line({"kind": name} | data)
