"""The session loop: events in, record and results out, the same for live devices and a replay."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ursnav_torch.devices import Frame, Note, TrackerSample
from ursnav_torch.session.events import Event, Result
from ursnav_torch.session.source import EventSource

#: Sees every event of a session, results included; must be quick.
Observer = Callable[[Event], None]
_NAMES = {"Frame": "pictures", "TrackerSample": "EM samples", "CommandSample": "commands", "Result": "results",
          "Snapshot": "snapshots"}  # fmt: skip


class Worker(Protocol):
    """Computes results from a session's events, in threads of its own or at once."""

    def take(self, event: Event) -> None:
        """Take an event; must not wait."""

    def wait(self) -> bool:
        """Wait until the last picture taken is dealt with; False when that took too long."""

    def results(self) -> Sequence[Result]:
        """The results made since the last call."""


@dataclass(slots=True)
class Summary:
    """What a session brought.

    Attributes:
        counts: events by kind.
        lost: gaps in the sources' own numbers, by kind.
        dropped: events that nobody took in time.
        faults: warnings and errors of devices, in order.
        outages_s: for how long each device gave nothing because it had failed; what was missed is in no count.
        seconds: how long it took.
    """

    counts: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    faults: list[str] = field(default_factory=list)
    outages_s: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    _last: dict[str, int] = field(default_factory=dict, repr=False)

    def add(self, event: Event) -> None:
        """Count an event; a source whose numbers begin anew was connected again."""
        kind = type(event).__name__
        self.counts[kind] = self.counts.get(kind, 0) + 1
        if isinstance(event, Note) and event.level != "info" and len(self.faults) < MOST_FAULTS:
            self.faults.append(event.text)
        if kind in ("Frame", "TrackerSample", "CommandSample"):
            number = event.source_frame if isinstance(event, TrackerSample) else event.stamp.sequence
            gap = number - self._last.get(kind, number - 1) - 1
            if gap > 0:
                self.lost[kind] = self.lost.get(kind, 0) + gap
            self._last[kind] = number

    def text(self) -> str:
        """The summary for people to read; "none lost" only where nothing was, and no device failed."""
        counts = ", ".join(f"{self.counts[kind]} {name}" for kind, name in _NAMES.items() if kind in self.counts)
        bad = [f"{n} {_NAMES[kind]} lost" for kind, n in self.lost.items()]
        bad += [f"{self.dropped} dropped"] * bool(self.dropped)
        if self.faults:
            bad.append(f"{len(self.faults)} device faults, the first: {self.faults[0]}")
        bad += [f"{name} gave nothing for {seconds:.1f} s" for name, seconds in self.outages_s.items()]
        return f"{self.seconds:.1f} s: {counts or 'nothing'}; {'; '.join(bad) or 'none lost'}"


#: A picture that is not dealt with after so long will never be; a busy machine takes seconds.
PATIENCE_S = 120.0
#: A device that fails for hours must not fill the memory with the same words.
MOST_FAULTS = 1000


def run_session(source: EventSource, worker: Worker | None = None, observers: Sequence[Observer] = ()) -> Summary:
    """Work through a session: every event to all observers, and to the worker, whose results are events, too.

    With a worker, the results of a replayed session are left out: they are made anew.

    Args:
        source: a live rig or a record's player.
        worker: computes results, or None.
        observers: the recorder, a status line, another program; called in this order.

    Raises:
        InputError: an observer cannot go on (a full disk); the source is then stopped.
    """
    summary, begun = Summary(), time.monotonic()

    def tell(event: Event) -> None:
        summary.add(event)
        for observer in observers:
            observer(event)

    with contextlib.ExitStack() as stack:
        stack.callback(source.stop)
        events = iter(source)
        stack.callback(getattr(events, "close", lambda: None))  # a generator ends its threads here, not some day
        for event in events:
            if worker is None or not isinstance(event, Result):
                tell(event)
            if worker is None:
                continue
            worker.take(event)
            if source.pace.patient and isinstance(event, Frame):
                _wait_for(worker)
            for result in worker.results():
                tell(result)
    if worker is not None:
        worker.wait()
        for result in worker.results():
            tell(result)
    summary.dropped, summary.outages_s = source.dropped, dict(source.outages_s)
    summary.seconds = time.monotonic() - begun
    return summary


def _wait_for(worker: Worker) -> None:
    """Wait until the last picture is dealt with: however slow the machine is, none is passed over."""
    until = time.monotonic() + PATIENCE_S
    while not worker.wait() and time.monotonic() < until:
        pass
