"""A line that says how a session goes."""

import math
import sys
import time
from typing import Any, TextIO

from ursnav_torch.devices import Frame, Note, RobotSample, TrackerSample
from ursnav_torch.session.events import Event


class StatusLine:
    """Says on a stream how a session goes: a line that renews itself on a terminal, else one every ten seconds."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._tty = self._stream.isatty()
        self._begun_s = self._said_s = time.monotonic()
        self._counts = {Frame: 0, TrackerSample: 0}
        self._robot: RobotSample | None = None

    def __call__(self, event: Event) -> None:
        """Take an event; the line is written at most five times a second."""
        if type(event) in self._counts:
            self._counts[type(event)] += 1
        elif isinstance(event, RobotSample):
            self._robot = event
        elif isinstance(event, Note) and self._tty:
            print(f"\r\033[K{event.level}: {event.text}", file=self._stream)
        now = time.monotonic()
        if now - self._said_s >= (0.2 if self._tty else 10.0):
            self._said_s = now
            end: dict[str, Any] = {"end": "", "flush": True} if self._tty else {}
            print(("\r\033[K" if self._tty else "") + self.text(now), file=self._stream, **end)

    def text(self, now_s: float) -> str:
        """The line as it stands."""
        seconds = now_s - self._begun_s
        parts = [f"{seconds:.0f} s", f"{self._counts[Frame]} pictures", f"{self._counts[TrackerSample]} EM samples"]
        if self._robot:
            j = self._robot.joints
            bend = f"bend {math.degrees(j.bend_x_rad):+.0f} {math.degrees(j.bend_y_rad):+.0f} deg"
            parts += [self._robot.state, bend, f"in {j.insertion_mm:.1f} mm"]
        return ", ".join(parts)

    def close(self) -> None:
        """End the line."""
        if self._tty:
            print(file=self._stream)
