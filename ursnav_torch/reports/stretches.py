"""A session's time in stretches: what was known when, and how surely."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ursnav_torch.session import Replay, Result
from ursnav_torch.tracking.tracker import TRACKING

#: Below this confidence, or without a place, a moment is doubtful once it lasts so long.
DOUBT, DOUBT_S = 0.6, 0.5
#: Pictures farther apart count for no longer than this.
LONGEST_GAP_S = 0.25
SURE, UNSURE = "sure", "unsure"


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of time, seconds from the record's beginning.

    Attributes:
        from_s, to_s: its ends.
        kind: ``sure``, ``unsure``, ``searching`` or ``lost``.
        calyx: observed in all of it; blank for none.
        frame: number of the picture in its middle.
        confidence: the lowest in it.
    """

    from_s: float
    to_s: float
    kind: str
    calyx: str
    frame: int
    confidence: float


def session_stretches(replay: Replay) -> list[Stretch]:
    """The stretches of a record that was navigated; none of one that was not."""
    first = next((event for event in replay.events() if not isinstance(event, Result)), None)
    begun_s = first.stamp.t_mono_s if first is not None else 0.0
    rows = [(r.frame, r.row) for r in replay.results() if "state" in r.row]
    return stretches_of([row["t_s"] - begun_s for _, row in rows], rows)


def stretches_of(t_s: Sequence[float], rows: Sequence[tuple[int, dict[str, Any]]]) -> list[Stretch]:
    """Stretches in which kind and calyx stay the same.

    Args:
        t_s: (N,) seconds of every picture.
        rows: (N,) its number and its results.
    """
    kinds = [kind_of(row) for _, row in rows]
    found, begun = [], 0
    for i in range(1, len(rows) + 1):
        if i < len(rows) and kinds[i] == kinds[begun]:
            continue
        kind, calyx = kinds[begun]
        last = t_s[i - 1] if i == len(rows) else min(t_s[i], t_s[i - 1] + LONGEST_GAP_S)
        least = min(float(row.get("confidence") or 0.0) for _, row in rows[begun:i])
        found.append(Stretch(float(t_s[begun]), float(last), kind, calyx, rows[(begun + i - 1) // 2][0], least))
        begun = i
    return found


def kind_of(row: dict[str, Any]) -> tuple[str, str]:
    """How sure a picture's result is, and the calyx it names."""
    if row["accepted"]:
        return (SURE if float(row["confidence"]) >= DOUBT else UNSURE), str(row["calyx"] or "")
    return (UNSURE if row["state"] == TRACKING else str(row["state"])), ""
