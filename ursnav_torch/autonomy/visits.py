"""The account of an exploration: what became of every calyx, and why."""

from dataclasses import asdict, dataclass
from typing import Any

OPEN, INSPECTED, PARTLY, UNSEEN = "open", "inspected", "partly seen", "not seen"
NOT_REACHED, NOT_TRIED = "not reached", "not tried"


@dataclass(slots=True)
class Visit:
    """What became of one calyx.

    Attributes:
        calyx: its name.
        verdict: ``open`` until it is known. Then ``inspected``; ``partly seen`` or ``not seen`` where nothing was in
            the way; ``not reached`` where something was, however much was seen past it; or ``not tried``: no way in was
            begun before the exploration ended.
        share: part of its wall that was seen, of what the scope can see of it.
        reason: why it was not inspected.
        attempts: ways in that were tried.
        nearest_mm: how near the tip came to the calyx's tip, along the way; infinite before the first attempt.
    """

    calyx: str
    verdict: str = OPEN
    share: float = 0.0
    reason: str = ""
    attempts: int = 0
    nearest_mm: float = float("inf")

    @property
    def tried(self) -> bool:
        """Whether a way in was begun."""
        return self.nearest_mm < float("inf")

    def close(self, least: tuple[float, float], reason: str, blocked: str = "") -> None:
        """The verdict, by what was seen and what was in the way.

        Args:
            least: shares of the wall from which on it is partly seen and inspected.
            reason: why no more was seen.
            blocked: what was in the way; empty for nothing.
        """
        glimpsed, done = least
        if self.share >= done:
            self.verdict, self.reason = INSPECTED, ""
        elif blocked:
            self.verdict, self.reason = NOT_REACHED, blocked
        elif not self.tried:
            self.verdict, self.reason = NOT_TRIED, reason
        else:
            self.verdict, self.reason = (PARTLY if self.share >= glimpsed else UNSEEN), reason

    def to_dict(self) -> dict[str, Any]:
        """As it is kept in files; what is not known is left out."""
        plain = asdict(self) | {"share": round(self.share, 4), "nearest_mm": round(self.nearest_mm, 1)}
        return {k: v for k, v in plain.items() if v not in ("", float("inf"))}

    def text(self) -> str:
        """The line that people read."""
        why = f" ({self.reason})" if self.reason else ""
        return f"{self.calyx}: {self.verdict}{why}, {self.share:.0%} of its wall seen"


@dataclass(frozen=True, slots=True)
class Explored:
    """The account at an exploration's end.

    Attributes:
        visits: what became of each calyx.
        reason: why it ended.
        finished: whether nothing was left to do.
    """

    visits: tuple[Visit, ...]
    reason: str
    finished: bool

    def to_dict(self) -> dict[str, Any]:
        """The content of ``explored.json``."""
        return {"finished": self.finished, "reason": self.reason, "calyces": [v.to_dict() for v in self.visits]}

    def text(self) -> str:
        """The report that people read: what was seen, what not, and why."""
        done = sum(v.verdict == INSPECTED for v in self.visits)
        end = "Explored by itself" if self.finished else "Not explored to the end"
        lines = [f"{end} ({self.reason}): {done} of {len(self.visits)} calyces inspected"]
        return "\n".join([*lines, *(f"  {v.text()}" for v in self.visits)])
