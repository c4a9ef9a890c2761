"""Whether a way in gets on: how far the tip came, and whether it follows the shaft that is pushed."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.perception import Perception
from ursnav_torch.autonomy.settings import AutonomySettings

Array = NDArray[np.float64]

#: Pictures are weighed into how far the scope has got with this time constant, s: alike at any rate of the camera.
_SMOOTH_S = 0.23
#: Cycles of control whose insertion is kept: longer than a picture's answer takes.
_KEPT = 100
#: A tip that makes less of the way that the shaft was pushed meets resistance.
_FOLLOWS = 0.3
#: Getting on by less than this is none, mm at scale 1.
_PROGRESS_MM = 0.25


class Push:
    """The shaft's push on one way in, beside what pictures see of it.

    Args:
        settings: lengths in mm of this kidney.
        unit_mm: 1 mm at scale 1, in mm of this kidney.

    Attributes:
        best_mm: how far along the way the tip came.
        place_mm: (3,) where the tip is by pictures old and new, as one alone is not sharp enough to tell resistance.
    """

    def __init__(self, settings: AutonomySettings, unit_mm: float) -> None:
        self._settings, self._progress_mm = settings, _PROGRESS_MM * unit_mm
        self._insertions: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._pulled = True  # whether the slider moved back last
        self.place_mm, self._seen_s, self._mark = np.zeros(3), 0.0, np.zeros(3)
        self._inserted = 0.0  # when the newest pictures were taken
        self.best_mm, self._best_s, self._from = 0.0, 0.0, 0.0

    def cycle(self, seen: Perception) -> None:
        """Keep the insertion of a cycle of control."""
        step = seen.insertion_mm - self._insertions[-1][1] if self._insertions else 0.0
        self._pulled = self._pulled if step == 0 else step < 0
        self._insertions.append((seen.t_s, seen.insertion_mm))

    def begin(self, seen: Perception, place_mm: Array, along_mm: float) -> None:
        """Begin a way in from a place (3,), so far along it."""
        self.place_mm, self._seen_s, self._inserted = place_mm, seen.seen_s, self._inserted_at(seen.seen_s)
        self.best_mm, self._best_s, self._mark = along_mm, seen.t_s, place_mm
        slack = self._settings.slack_mm if seen.slack_mm is None else seen.slack_mm
        self._from = self._inserted + (slack if self._pulled else 0.0)  # who came by pulling turns the slider first

    def see(self, seen: Perception, place_mm: Array) -> None:
        """Weigh in where the newest picture sees the tip, (3,), and how far the shaft was in when it was taken."""
        if seen.seen_s != self._seen_s:
            news = 1 - float(np.exp(-max(seen.seen_s - self._seen_s, 0.0) / _SMOOTH_S))
            self._seen_s, self.place_mm = seen.seen_s, self.place_mm + news * (place_mm - self.place_mm)
            self._inserted += news * (self._inserted_at(seen.seen_s) - self._inserted)

    def gets_on(self, along_mm: float, t_s: float) -> bool:
        """Whether the tip, so far along the way by now, got on within what patience there is."""
        if along_mm > self.best_mm + self._progress_mm:
            self.best_mm, self._best_s = along_mm, t_s
        return t_s - self._best_s <= self._settings.patience_s

    def resists(self, axis: Array) -> bool:
        """Whether the shaft was pushed and the tip did not follow along its axis (3,)."""
        pushed = self._inserted - self._from
        if pushed <= 0:  # the slider turns round, and the tip may swing
            self._mark = self.place_mm
        if pushed < self._settings.resistance_mm:
            return False
        followed = float((self.place_mm - self._mark) @ axis)
        self._from, self._mark = self._inserted, self.place_mm
        return followed < _FOLLOWS * pushed

    def _inserted_at(self, t_s: float) -> float:
        """The insertion at a time, mm."""
        told_s, insertion = zip(*self._insertions, strict=True)
        return float(np.interp(t_s, told_s, insertion))
