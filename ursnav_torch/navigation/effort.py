"""Keeping up on a slow machine: first poses are refined less, then fewer places are searched, and back again."""

from collections import deque
from statistics import median

#: What each level of effort means, in plain words.
WORDS = (
    "",
    "Slow machine: refining less.",
    "Slow machine: refining and searching less.",
)
WINDOW = 8
RELAPSE = 120


class Governor:
    """Chooses the level of effort from how long pictures take; one level at a time.

    Args:
        budget_s: time from a picture's capture to its pose above which less is spent.
        patience: pictures that must take less than half of it before more is spent again; doubled whenever that
            turns out to have been too soon.
    """

    def __init__(self, budget_s: float = 0.13, patience: int = 60) -> None:
        self.budget_s, self.patience = budget_s, patience
        self.level = 0
        self._recent: deque[float] = deque(maxlen=WINDOW)
        self._quick, self._since_eased, self._waiting_for = 0, RELAPSE, patience

    def observe(self, total_s: float) -> int:
        """Take the time that one picture took; returns the level for the next."""
        self._recent.append(total_s)
        self._since_eased += 1
        usual = median(self._recent)
        self._quick = self._quick + 1 if usual < self.budget_s / 2 else 0
        if len(self._recent) == WINDOW and usual > self.budget_s and self.level < len(WORDS) - 1:
            if self._since_eased < RELAPSE:
                self._waiting_for = min(2 * self._waiting_for, 16 * self.patience)
            self._change(1)
        elif self.level and self._quick >= self._waiting_for:
            self._change(-1)
            self._since_eased = 0
        return self.level

    def _change(self, by: int) -> None:
        self.level += by
        self._quick = 0
        self._recent.clear()
