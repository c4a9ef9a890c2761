"""Where a session's events come from, live or replayed, behind one contract."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from ursnav_torch.session.events import Event


@dataclass(frozen=True, slots=True)
class Pace:
    """How a source's pictures come.

    Attributes:
        stamped_now: a picture's stamp tells by this machine's clock when it was captured; else it counts as captured
            when it is given (a replay, a simulation that draws after the stamp).
        steady: pictures come without pause, so that a gap is worth saying; a replay may be paused.
        patient: the source waits until each picture is dealt with; else the newest goes first.
    """

    stamped_now: bool = True
    steady: bool = True
    patient: bool = False


class EventSource(Protocol):
    """Gives out events until it ends or is stopped."""

    @property
    def pace(self) -> Pace:
        """How its pictures come."""

    @property
    def dropped(self) -> int:
        """Events that were lost because nobody took them in time."""

    @property
    def outages_s(self) -> Mapping[str, float]:
        """For how long each device gave nothing because it had failed."""

    def stop(self) -> None:
        """End; may be called from any thread, and any number of times."""

    def __iter__(self) -> Iterator[Event]:
        """All events, in the order of their arrival."""


class LosslessSource:
    """What is the same in every source that waits for its reader and has no devices that fail."""

    @property
    def dropped(self) -> int:
        """Nothing: it waits."""
        return 0

    @property
    def outages_s(self) -> Mapping[str, float]:
        """Nothing: a record, or what is simulated by arithmetic, does not fail."""
        return {}
