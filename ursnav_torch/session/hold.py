"""Holding a session: devices or a record, kept or not, with a line that says how it goes."""

import contextlib
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TextIO

from ursnav_torch.devices import Frame, Note, Output, RobotSample, TrackerSample
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.session.events import Event, Result
from ursnav_torch.session.live import Live
from ursnav_torch.session.record import Recorder
from ursnav_torch.session.replay import Replay
from ursnav_torch.session.rig import Rig, World
from ursnav_torch.session.run import Locate, Summary, run_session

POSITION, QUATERNION = ("x_mm", "y_mm", "z_mm"), ("qx", "qy", "qz", "qw")


def hold_session(
    hardware: Replay | Callable[..., Rig],
    world: Callable[[], World] | None = None,
    recorder: Recorder | None = None,
    duration_s: float = 0.0,
    locate: Locate | None = None,
    on_event: Callable[[Event], None] | None = None,
) -> Summary:
    """Connect what there is, work through the session, disconnect.

    Args:
        hardware: a record, or what builds a rig when given ``world`` (a partial of `build_rig`).
        world: makes the anatomy of a simulated scope; called only when there is one.
        recorder: where everything goes, or None.
        duration_s: end after so long; 0 for no end. A replay ends with its record.
        locate, on_event: see `run_session`.

    Raises:
        InputError: the record is to be written over itself.
        DeviceError: a device cannot be connected.
    """
    with contextlib.ExitStack() as stack:
        observers = [on_event] if on_event else []
        if isinstance(hardware, Replay):
            if recorder and recorder.path.absolute() == hardware.path.absolute():
                raise InputError(
                    f"{hardware.path} cannot be replayed and written at the same time; choose another out=."
                )
            source: Live | Replay = hardware
        else:
            rig = stack.enter_context(hardware(world=world))
            source = Live(rig, duration_s)
            if rig.output:
                observers.append(partial(share, rig.output))
        if recorder:
            stack.enter_context(recorder)
        return run_session(source, recorder, locate, _all(observers), keep_results=False)


def share(output: Output, event: Event) -> None:
    """Show an event to another program: pictures, joints, and the pose in a result's row that was accepted."""
    if isinstance(event, Frame):
        output.publish_image(event)
    elif isinstance(event, RobotSample):
        output.publish_joints(event.joints, event.stamp.t_wall_s)
    elif isinstance(event, Result) and event.row.get("accepted") and event.row.get("x_mm") is not None:
        position, quaternion = ([float(event.row[c]) for c in names] for names in (POSITION, QUATERNION))
        output.publish_pose(transform_from_quaternion(position, quaternion), event.stamp.t_wall_s)


def _all(observers: list[Callable[[Event], None]]) -> Callable[[Event], None]:
    def tell(event: Event) -> None:
        for observer in observers:
            observer(event)

    return tell


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
