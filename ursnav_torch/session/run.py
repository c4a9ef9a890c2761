"""A session from end to end: events in, record and results out, live and replayed alike."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ursnav_torch.devices import Frame, Stamper, TrackerSample
from ursnav_torch.errors import UrsnavError
from ursnav_torch.session.events import Event, Result
from ursnav_torch.session.live import Live
from ursnav_torch.session.record import Recorder
from ursnav_torch.session.replay import Replay

#: A live picture older than this when its turn comes is recorded but no longer located.
STALE_S = 0.3
Locate = Callable[[Frame, TrackerSample | None], dict[str, Any]]


@dataclass(slots=True)
class Summary:
    """What a session brought: events by kind, lost ones, results, and how long it took."""

    counts: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    not_located: int = 0
    seconds: float = 0.0
    results: list[Result] = field(default_factory=list)

    def text(self) -> str:
        """The summary for people to read."""
        names = {"Frame": "pictures", "TrackerSample": "EM samples", "CommandSample": "commands", "Result": "results",
                 "Snapshot": "snapshots"}  # fmt: skip
        counts = ", ".join(f"{self.counts[kind]} {name}" for kind, name in names.items() if kind in self.counts)
        lost = ", ".join(f"{n} {names[kind]}" for kind, n in self.lost.items())
        lost = f"lost: {lost}" if lost else "none lost"
        return f"{self.seconds:.1f} s: {counts or 'nothing'}; {lost}" + (
            f"; {self.dropped} dropped" if self.dropped else ""
        )


def run_session(
    source: Live | Replay,
    recorder: Recorder | None = None,
    locate: Locate | None = None,
    on_event: Callable[[Event], None] | None = None,
    keep_results: bool = True,
) -> Summary:
    """Work through a session.

    Live, a picture whose turn comes late is recorded but not located. A replay locates exactly the pictures that were
    located then (all, if none were), so that the same code gives the same rows and newer code comparable ones.

    Args:
        source: a live rig or a record.
        recorder: where everything goes, or None.
        locate: computes a row of plain values from a picture and the newest EM sample before it; where it raises the
            package's own errors, the row holds only ``error``.
        on_event: sees every event, results included; must be quick.
        keep_results: False for sessions without end: results then go to recorder and observer alone.

    Returns:
        Counts, losses by gaps in the sources' own numbers, and the results.
    """
    summary, begun = Summary(), time.monotonic()
    chosen = source.located_frames() if isinstance(source, Replay) and locate else None
    stamp, tracker = Stamper(), None
    spans: dict[str, tuple[int, int]] = {}

    def take(event: Event) -> None:
        kind = type(event).__name__
        summary.counts[kind] = summary.counts.get(kind, 0) + 1
        number = event.source_frame if isinstance(event, TrackerSample) else event.stamp.sequence
        spans[kind] = (spans.get(kind, (number, 0))[0], number)
        if recorder:
            recorder.write(event)
        if on_event:
            on_event(event)
        if isinstance(event, Result) and keep_results:
            summary.results.append(event)

    for event in source:
        if isinstance(event, Result) and locate:
            continue  # computed anew
        take(event)
        if isinstance(event, TrackerSample):
            tracker = event
        if locate and isinstance(event, Frame):
            late = isinstance(source, Live) and time.monotonic() - event.stamp.t_mono_s > STALE_S
            if late or (chosen is not None and event.stamp.sequence not in chosen):
                summary.not_located += 1
            else:
                take(Result(stamp(), event.stamp.sequence, _row(locate, event, tracker)))
    for kind, (first, last) in spans.items():
        if kind in ("Frame", "TrackerSample", "CommandSample") and (lost := last - first + 1 - summary.counts[kind]):
            summary.lost[kind] = lost
    summary.dropped = source.dropped if isinstance(source, Live) else 0
    summary.seconds = time.monotonic() - begun
    return summary


def _row(locate: Locate, frame: Frame, tracker: TrackerSample | None) -> dict[str, Any]:
    """The row of a picture; one that cannot be located has only an ``error``."""
    try:
        return locate(frame, tracker)
    except UrsnavError as error:
        return {"error": str(error)}
