"""What velocities were ordered of late: the motion that a board may have made, or not, since its newest report."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.geometry import Array

#: Motion that the newest report does not tell: it is up to 0.05 s old when it comes, orders end 0.14 s after that, and
#: they or the report may have come 0.03 s late.
UNSEEN_S = 0.22
#: Orders that were sent before this were carried out, or replaced, before the newest report.
PAST_S = 0.3


class RecentOrders:
    """Interval arithmetic on orders that replace each other, each a velocity (3,) for a short time."""

    def __init__(self) -> None:
        self._orders: deque[tuple[float, Array]] = deque()

    def add(self, now: float, velocity: Array) -> None:
        """A velocity (3,) was ordered."""
        self._orders.append((now, velocity))

    def clear(self) -> None:
        """The motors rest, and their place is told."""
        self._orders.clear()

    def unseen(self, now: float) -> tuple[Array, Array]:
        """How far back and forth, (3,) each, the motors may be from the newest report."""
        while self._orders and now - self._orders[0][0] > PAST_S:
            self._orders.popleft()
        ordered = np.array([np.zeros(3), *(velocity for _, velocity in self._orders)])
        return UNSEEN_S * ordered.min(axis=0), UNSEEN_S * ordered.max(axis=0)


#: A jog is surely made this long after it should have ended.
LATE_S = 0.1


class QueuedJogs:
    """Interval arithmetic on jogs that a board makes one after the other: those that it may not have made yet."""

    def __init__(self) -> None:
        self._jogs: deque[tuple[float, Array]] = deque()

    def add(self, ends_s: float, step: Array) -> None:
        """A jog by (3,) was sent that should end at a time."""
        self._jogs.append((ends_s, step))

    def unmade(self, now: float) -> tuple[Array, Array]:
        """How far back and forth, (3,) each, the axes may still go from where they are."""
        while self._jogs and now - self._jogs[0][0] > LATE_S:
            self._jogs.popleft()
        steps = np.array([np.zeros(3), *(step for _, step in self._jogs)])
        return np.minimum(steps, 0.0).sum(axis=0), np.maximum(steps, 0.0).sum(axis=0)


def is_against(step: Array, back: Array, forth: Array) -> NDArray[np.bool_]:
    """(3,) which axes a motion by (3,) moves against motion that may go back and forth by (3,) each."""
    return np.asarray(((step > 0) & (back < 0)) | ((step < 0) & (forth > 0)))
