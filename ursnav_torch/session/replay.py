"""Reading a session back, whole or cut off."""

import logging
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ursnav_torch.devices import Frame, TrackerSample
from ursnav_torch.devices.cameras import decode_image
from ursnav_torch.errors import InputError
from ursnav_torch.inputs import read_regular
from ursnav_torch.locks import partial_path
from ursnav_torch.pictures import MOST_BYTES
from ursnav_torch.records import parse_json, read_json, to_record
from ursnav_torch.session.events import Event, Result, Snapshot, from_line, stamp_of
from ursnav_torch.session.record import ABOUT, EVENTS, FORMAT, FRAMES

logger = logging.getLogger(__name__)

#: Bytes of a line; the longest that is written, a result's, has some hundred.
LONGEST_LINE = 1 << 20
#: What a line calls a `Result`.
RESULT = "result"


class Replay:
    """The events of a record, in the order in which they were written.

    A record that a crash cut off is read as far as it goes: a last line without its end and pictures whose file is
    cut are left out, counted in `damaged` and reported once in the log.

    Args:
        path: the record's folder; ``NAME.partial`` is taken where ``NAME`` does not exist.
        speed: at which a `Player` plays it: 1 for the session's own pace, 2 for twice as fast, 0 for as fast as
            possible.

    Raises:
        InputError: there is no record, it is of a newer format, or the speed is negative.
    """

    def __init__(self, path: str | Path, speed: float = 1.0) -> None:
        path = Path(path)
        self.path = path if path.exists() else partial_path(path)
        if not (self.path / EVENTS).is_file():
            raise InputError(f"{path} is no recorded session: there is no {EVENTS} in it.")
        if speed < 0:
            raise InputError(f"speed must be 0 (as fast as possible) or more, got {speed}.")
        self.speed, self.damaged = speed, 0
        self.about: dict[str, Any] = self._read_about()

    def __iter__(self) -> Iterator[Event]:
        """All events as fast as they can be read; `Player` keeps the session's own pace."""
        return self.events()

    def events(self, from_s: float = 0.0) -> Iterator[Event]:
        """Events from some seconds after the first one on, as fast as they can be read; no picture before is read."""
        self.damaged = 0
        first_s: float | None = None
        t_s: float | None = None
        last: Frame | None = None
        for data in self._lines():
            # A result is stamped when it is made, which may be on another day than its picture was taken.
            t_s = t_s if data["kind"] == RESULT else _time(data)
            first_s = t_s if first_s is None else first_s
            early = from_s > 0 and t_s is not None and first_s is not None and t_s - first_s < from_s
            event = None if early else self._event(data, last)
            if event is None:
                continue
            if isinstance(event, Frame):
                last = event
            yield event
        if self.damaged:
            logger.warning("%s: %d damaged items were left out.", self.path, self.damaged)

    def duration_s(self) -> float:
        """Time from the first event to the last, results apart, which may have been made on another day."""
        times = [t for t in (_time(data) for data in self._lines() if data["kind"] != RESULT) if t is not None]
        return max(times) - times[0] if times else 0.0

    def results(self) -> list[Result]:
        """The results as they were recorded."""
        return [event for event in self._of_kind(RESULT) if isinstance(event, Result)]

    def readings(self) -> list[TrackerSample]:
        """The EM tracker's samples as they were recorded, those where it saw nothing as well."""
        return [event for event in self._of_kind("tracker") if isinstance(event, TrackerSample)]

    def _of_kind(self, kind: str) -> Iterator[Event | None]:
        """The events of one kind; no picture is read."""
        return (self._event(data, None) for data in self._lines() if data["kind"] == kind)

    def _lines(self) -> Iterator[dict[str, Any]]:
        with (self.path / EVENTS).open("rb") as file:
            while raw := file.readline(LONGEST_LINE):
                try:
                    data = parse_json(raw, "the line") if raw.endswith(b"\n") else None
                except InputError:
                    data = None
                if isinstance(data, dict) and "kind" in data and "stamp" in data:
                    yield data
                else:
                    self.damaged += 1

    def _event(self, data: dict[str, Any], last: Frame | None) -> Event | None:
        try:
            if data["kind"] == "frame":
                return self._frame(data)
            event = from_line(data)
            if isinstance(event, Snapshot):
                return Snapshot(event.stamp, self._snapshot_frame(data, last), event.tracker, event.robot)
            return event
        except (KeyError, TypeError, ValueError, OSError, OverflowError) as error:
            logger.debug("%s: %s", self.path, error)
            self.damaged += 1
            return None

    def _frame(self, data: dict[str, Any]) -> Frame:
        """The picture of a frame's line, byte for byte.

        Raises:
            InputError: the file is missing, is not in the record's folder, or is no regular file.
            ValueError: the file is not the one that was written.
        """
        encoded = read_regular(self._inside(str(data["file"])), "picture", MOST_BYTES)
        if len(encoded) != data["bytes"] or zlib.crc32(encoded) != data["crc32"]:
            raise ValueError(f"{data['file']} is damaged")
        image = decode_image(encoded, str(data["file"]))
        kept = encoded if data["kept"] else None
        return Frame(stamp_of(data), image, kept, str(data["suffix"]), str(data["source"]))

    def _inside(self, name: str) -> Path:
        """The path of a picture that a line names; nothing leads out of the record, a link neither.

        Raises:
            InputError: it lies elsewhere.
        """
        path = self.path / name
        if not path.resolve().is_relative_to((self.path / FRAMES).resolve()):
            raise InputError(f"{name} does not lie among the pictures of the record.")
        return path

    def _snapshot_frame(self, data: dict[str, Any], last: Frame | None) -> Frame | None:
        return last if last and data["frame"] == last.stamp.sequence else None

    def _read_about(self) -> dict[str, Any]:
        """What the record says about itself; nothing where a crash has spoiled it."""
        try:
            about = to_record(read_json(self.path / ABOUT, "record"), dict[str, Any], f"{self.path / ABOUT}")
            newest = int(about.get("format", FORMAT))
        except (ValueError, TypeError):
            logger.warning("%s: %s is missing or cut; versions and configuration are unknown.", self.path, ABOUT)
            return {}
        if newest > FORMAT:
            raise InputError(
                f"{self.path} has record format {about['format']}, this version reads up to {FORMAT}; "
                "update ursnav-torch."
            )
        return dict(about)


def _time(data: dict[str, Any]) -> float | None:
    try:
        return float(data["stamp"][1])
    except (TypeError, ValueError, IndexError, KeyError, OverflowError):
        return None
