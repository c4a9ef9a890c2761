"""The items of a session, and each as a line of JSON and back."""

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

from ursnav_torch.devices import (
    CommandSample,
    Frame,
    JointRates,
    Joints,
    LightSample,
    Note,
    OperatorInput,
    RobotSample,
    Stamp,
    TrackerSample,
)


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
_NESTED = {"stamp": Stamp, "requested": JointRates, "sent": JointRates, "joints": Joints}


def to_line(event: Event, **extra: Any) -> str:
    """One line of JSON, without the end of line; pictures are left out, ``extra`` is added.

    Raises:
        ValueError: a number is not finite.
        TypeError: a result's row holds something that JSON does not know.
    """
    fields = {f.name: getattr(event, f.name) for f in dataclasses.fields(event)}
    plain = {name: _plain(value) for name, value in fields.items() if name not in ("image", "encoded", "frame")}
    if isinstance(event, Result):
        plain["frame"] = event.frame
    elif isinstance(event, Snapshot):
        plain["frame"] = event.frame.stamp.sequence if event.frame else None
    line = {"kind": NAMES[type(event)]} | plain | extra
    return json.dumps(line, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def from_line(data: dict[str, Any]) -> Event | None:
    """The event of a parsed line, or None where the kind is not known (a record of a newer version) or is a frame's.

    Raises:
        KeyError, TypeError, ValueError: the line does not hold what its kind needs.
    """
    kind = KINDS.get(data["kind"])
    if kind is None or kind is Frame:
        return None
    known = {f.name for f in dataclasses.fields(kind)}
    values = {name: _typed(name, value) for name, value in data.items() if name in known}
    if kind is Snapshot:
        values |= {"frame": None, "tracker": _sample("tracker", data), "robot": _sample("robot", data)}
    event: Event = kind(**values)
    return event


def stamp_of(data: dict[str, Any]) -> Stamp:
    """The stamp of a parsed line."""
    return Stamp(*data["stamp"])


def _plain(value: Any) -> Any:
    if isinstance(value, Stamp):
        return [value.sequence, value.t_mono_s, value.t_wall_s]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return value


def _typed(name: str, value: Any) -> Any:
    if name == "stamp":
        return Stamp(*value)
    if name in _NESTED:
        return _NESTED[name](**value)
    return tuple(value) if isinstance(value, list) else value


def _sample(name: str, data: dict[str, Any]) -> Any:
    return None if data[name] is None else from_line({"kind": name} | data[name])
