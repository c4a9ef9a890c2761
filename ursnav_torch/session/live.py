"""A running session: a supervised thread for each source, one queue, and the robot driven beside it."""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ursnav_torch.devices import (
    SILENT_S,
    Device,
    Frame,
    Note,
    OperatorInput,
    RobotSample,
    Stamp,
    Stamper,
    TrackerSample,
)
from ursnav_torch.session.control import Control
from ursnav_torch.session.events import Event, Snapshot
from ursnav_torch.session.rig import Rig
from ursnav_torch.session.source import Pace
from ursnav_torch.session.supervise import Supervisor

CONTROL_HZ = 50.0
CATCH_UP_S = 0.1  # cycles that a busy machine delayed are made up for, up to this long ago


class Live:
    """The events of a connected rig, as they happen, until the operator quits or the pictures end.

    Camera and tracker are read by threads of their own; the operator drives the robot 50 times a second in another,
    whatever the reader of the events is busy with. Whatever a device does is reported as a note, see `Supervisor`.

    Args:
        rig: the devices, connected.
        duration_s: end after so long; 0 for no end.
        backlog: how many events may wait to be read; more are dropped, counted in `dropped`.
    """

    def __init__(self, rig: Rig, duration_s: float = 0.0, backlog: int = 20_000) -> None:
        self.rig, self.duration_s = rig, duration_s
        self.dropped = 0
        self.longest_cycle_s = 0.0
        self._queue: queue.Queue[Event] = queue.Queue(maxsize=backlog)
        self._end = threading.Event()
        self._note = Stamper()
        self._snapshot = Stamper()
        self._supervisor = Supervisor(self._tell, self._end)

    @property
    def pace(self) -> Pace:
        """Devices give pictures without pause; a simulation stamps them before it has drawn them."""
        return Pace(stamped_now=self.rig.twin is None)

    @property
    def outages_s(self) -> dict[str, float]:
        """For how long each device gave nothing because it had failed."""
        return dict(self._supervisor.outages_s)

    def stop(self) -> None:
        """End the session; what has happened so far is still given out."""
        self._end.set()

    @property
    def waiting(self) -> int:
        """How many events wait to be read."""
        return self._queue.qsize()

    def __iter__(self) -> Iterator[Event]:
        """All events in the order of their arrival; a snapshot follows the press of its button."""
        threads = self._start()
        latest: dict[type[Any], Any] = {}
        timer = threading.Timer(self.duration_s or threading.TIMEOUT_MAX, self._end.set)
        timer.daemon = True
        timer.start()
        try:
            while not (self._end.is_set() and self._queue.empty()):
                try:
                    event = self._queue.get(timeout=0.05)
                except queue.Empty:
                    continue
                latest[type(event)] = event
                yield event
                if isinstance(event, OperatorInput):
                    if event.snapshot:
                        yield snapshot_of(self._snapshot(), latest)
                    if event.quit:
                        self._end.set()
        finally:
            self._end.set()
            timer.cancel()
            self._disarm()
            for thread in threads:
                thread.join(timeout=2.0)
            self._disarm()  # the last cycle may have armed

    def _disarm(self) -> None:
        if self.rig.robot and self.rig.robot.is_connected:
            self.rig.robot.disarm()

    def _start(self) -> list[threading.Thread]:
        jobs: list[tuple[str, Callable[[], None]]] = []
        if self.rig.camera:
            camera = self.rig.camera
            jobs.append(("session-camera", lambda: self._pump(camera, camera.read, ends_session=True)))
        if self.rig.tracker:
            tracker = self.rig.tracker
            jobs.append(("session-tracker", lambda: self._pump(tracker, tracker.read)))
        if self.rig.gamepad:
            control = Control(self.rig.robot, self.rig.gamepad, self.rig.light)
            jobs.append(("session-control", lambda: self._control(control)))
        threads = [threading.Thread(target=job, name=name, daemon=True) for name, job in jobs]
        for thread in threads:
            thread.start()
        return threads

    def _put(self, event: Event) -> None:
        try:
            self._queue.put_nowait(event)
        except queue.Full:
            self.dropped += 1

    def _tell(self, level: str, text: str) -> None:
        self._put(Note(self._note(), level, text))

    def _pump(self, device: Device, read: Callable[[float], Event], ends_session: bool = False) -> None:
        """Move a device's samples to the queue until it is at its end."""
        self._supervisor.run(device, lambda: self._put(read(SILENT_S)))
        if ends_session:
            self._end.set()

    def _control(self, control: Control) -> None:
        """Drive, in step with the clock; at the end, and at any fault of the input device, the robot is disarmed."""
        recent: deque[str] = deque(maxlen=1)
        due = time.monotonic()

        def cycle() -> None:
            nonlocal due
            self._end.wait(max(0.0, due - time.monotonic()))
            begun = time.monotonic()
            due = max(due + 1 / CONTROL_HZ, begun - CATCH_UP_S)
            try:
                events = control.step()
            except BaseException:
                self._disarm()
                raise
            for event in events:
                if not isinstance(event, Note):
                    self._put(event)
                elif event.text not in recent:  # a fault that lasts is said once
                    recent.append(event.text)
                    self._supervisor.tell(event.level, event.text)
            self.longest_cycle_s = max(self.longest_cycle_s, time.monotonic() - begun)

        try:
            self._supervisor.run(control.gamepad, cycle)
        finally:
            self._disarm()


def snapshot_of(stamp: Stamp, latest: Mapping[type[Any], Any]) -> Snapshot:
    """A snapshot of the latest event of each kind: the picture, and what was told about when it was taken.

    What a device said before it fell silent is left out, as `SILENT_S` has it.
    """
    frame: Frame | None = latest.get(Frame)
    at_s = stamp.t_mono_s if frame is None else frame.stamp.t_mono_s
    said = (latest.get(kind) for kind in (TrackerSample, RobotSample))
    return Snapshot(stamp, frame, *(s if s and abs(s.stamp.t_mono_s - at_s) <= SILENT_S else None for s in said))
