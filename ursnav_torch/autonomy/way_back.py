"""The way back in the joints: who loses the place goes back to where it was known, bent as the scope came.

What was passed once is free, and the shaft comes back through it with the bend that it went in with.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.kinematics import Segment

Array = NDArray[np.float64]

#: Joints that are kept lie so far apart, and count as reached within half of it, by the tip's way, mm at scale 1; set,
#: not varied.
_STEP_MM = 1.0


class WayBack:
    """Joints (3,) at which the place was known, in the order in which they lead to where the scope is now.

    Loops are left out, and what was drawn back. Joints are the bend about x and y in radians and the insertion in mm.

    Args:
        segment: the scope's bending tip.
        scale: the kidney's.
    """

    def __init__(self, segment: Segment, scale: float) -> None:
        self._mm_a_rad, self._step_mm = segment.length_mm / 2, _STEP_MM * scale
        self._passed: list[Array] = []

    def add(self, here: Array) -> None:
        """The place is known at some joints (3,)."""
        self._passed = [passed for passed in self._passed if passed[2] <= here[2] + self._step_mm / 2]
        for n, passed in enumerate(self._passed):
            if self.apart_mm(passed, here) < self._step_mm:
                del self._passed[n + 1 :]
                return
        self._passed.append(here)

    def next(self, here: Array) -> Array | None:
        """The joints (3,) to go back to from some others; those reached are forgotten. None where none are left."""
        while self._passed:
            to = self._passed[-1]
            if self.apart_mm(here, np.append(to[:2], min(to[2], here[2]))) >= self._step_mm / 2:
                return to
            self._passed.pop()
        return None

    def before(self, here: Array) -> Array | None:
        """The joints (3,) on the way in, drawn back a little from some others; None where none are known."""
        drawn_back = [passed for passed in self._passed if passed[2] <= here[2] - self._step_mm / 2]
        return drawn_back[-1] if drawn_back else None

    def apart_mm(self, one: Array, other: Array) -> float:
        """How far the tip goes, about, from some joints (3,) to others."""
        away = other - one
        return float(abs(away[2]) + self._mm_a_rad * np.hypot(away[0], away[1]))


def joints(bend_rad: ArrayLike, insertion_mm: float) -> Array:
    """Joints (3,) of a bend (2,) and an insertion."""
    return np.append(np.asarray(bend_rad, float), insertion_mm)
