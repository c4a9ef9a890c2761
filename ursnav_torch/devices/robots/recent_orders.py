"""What velocities were ordered of late: the motion that a board may have made, or not, since its newest report."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.geometry import Array

#: Motion that the newest report does not tell, at least: it is up to 0.05 s old when it comes, and orders end 0.14 s
#: after that; then comes `DELAY_S`.
UNSEEN_S = 0.22
#: An order comes to the board this long after it was sent, at most.
DELAY_S = 0.03


class RecentOrders:
    """Interval arithmetic on orders that replace each other, each a velocity (3,) for a short time."""

    def __init__(self) -> None:
        self._orders: deque[tuple[float, Array]] = deque()

    def add(self, ends_s: float, velocity: Array) -> None:
        """A velocity (3,) is or was ordered until a time; said again where the order went out later than meant."""
        self._orders.append((ends_s, velocity))

    def are_over(self, told_s: float) -> bool:
        """Whether a report made at ``told_s`` or later tells all that was ordered."""
        while self._orders and self._orders[0][0] + DELAY_S < told_s:
            self._orders.popleft()
        return not self._orders

    def unseen(self, told_s: float) -> tuple[Array, Array]:
        """How far back and forth, (3,) each, the motors may get from a report made at ``told_s`` or later."""
        if self.are_over(told_s):
            return np.zeros(3), np.zeros(3)
        lasts_s = max(UNSEEN_S, max(ends_s for ends_s, _ in self._orders) + DELAY_S - told_s)
        ordered = np.array([np.zeros(3), *(velocity for _, velocity in self._orders)])
        return lasts_s * ordered.min(axis=0), lasts_s * ordered.max(axis=0)


#: A jog is surely made this long after it should have ended: ramps are reckoned with, not known.
LATE_S = 0.1


class QueuedJogs:
    """Interval arithmetic on jogs that a board makes one after the other: those not made by the newest report.

    When a jog ends is told from when the board said that it took it, and which are made from when the newest report was
    asked for: between the host's other moments any time may pass, on a machine that is busy.
    """

    def __init__(self) -> None:
        self._jogs: deque[tuple[float, Array]] = deque()

    def add(self, step: Array) -> None:
        """A jog by (3,) is about to be sent; when it ends is not known."""
        self._jogs.append((math.inf, step))

    def taken(self, ends_s: float) -> None:
        """The board has taken the newest jog, which should end at a time."""
        self._jogs[-1] = ends_s, self._jogs[-1][1]

    def reported(self, asked_s: float) -> None:
        """The board has told where it is, having been asked at a time."""
        while self._jogs and asked_s - self._jogs[0][0] > LATE_S:
            self._jogs.popleft()

    def clear(self) -> None:
        """The board has told that it stands still."""
        self._jogs.clear()

    def unmade(self) -> tuple[Array, Array]:
        """How far back and forth, (3,) each, the axes may have gone from the newest report, or may still go."""
        steps = np.array([np.zeros(3), *(step for _, step in self._jogs)])
        return np.minimum(steps, 0.0).sum(axis=0), np.maximum(steps, 0.0).sum(axis=0)


def is_against(step: Array, back: Array, forth: Array) -> NDArray[np.bool_]:
    """(3,) which axes a motion by (3,) moves against motion that may go back and forth by (3,) each."""
    return np.asarray(((step > 0) & (back < 0)) | ((step < 0) & (forth > 0)))
