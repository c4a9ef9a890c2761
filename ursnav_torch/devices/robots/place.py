"""Where a robot's axes stand, with bounds, and when that is no longer known."""

import numpy as np
from numpy.typing import ArrayLike

from ursnav_torch.geometry import Array


class Place:
    """Dead reckoning of three axes by interval arithmetic.

    Between two reports the axes may be anywhere between the last report and where all that was sent ends. A controller
    that was reset counts from zero again: its reports then fall outside that interval and the place is *lost* until
    the operator confirms that the robot stands where it was last certain, or says where it stands. What the interval
    was wide then stays as ``slack`` on every place after it, and soft limits keep off by it.

    Args:
        tolerance: how far (3,) a report may lie outside the interval, in the axes' unit: rounding, a step more.
    """

    def __init__(self, tolerance: ArrayLike) -> None:
        self._tolerance = np.broadcast_to(np.asarray(tolerance, float), (3,))
        self.why_lost = ""
        self.slack: Array = np.zeros(3)
        self._low: Array = np.zeros(3)
        self._high: Array = np.zeros(3)
        self._reported: Array = np.zeros(3)

    @property
    def is_known(self) -> bool:
        """Whether reports can be believed."""
        return not self.why_lost

    @property
    def axes(self) -> Array:
        """(3,) the last report; while the place is lost, the middle of where the axes may be."""
        return self._reported if self.is_known else (self._low + self._high) / 2

    @property
    def width(self) -> Array:
        """(3,) how wide the interval is in which the axes are."""
        return self._high - self._low

    def sent(self, end: Array) -> None:
        """Motion was sent that ends at (3,)."""
        self._low, self._high = np.minimum(self._low, end), np.maximum(self._high, end)

    def moves(self, step: Array) -> None:
        """Motion by (3,) was sent, to be made wherever what was sent before has taken the axes, or has not."""
        self._low, self._high = self._low + np.minimum(step, 0.0), self._high + np.maximum(step, 0.0)

    def report(self, axes: Array, ends: Array) -> bool:
        """Take the controller's report (3,); motion under way ends at ``ends``, which is ``axes`` at a standstill.

        Returns:
            Whether it can be believed; one that cannot loses the place.
        """
        if not self.check(axes):
            return False
        self._low, self._high = np.minimum(axes, ends), np.maximum(axes, ends)
        return True

    def check(self, axes: Array) -> bool:
        """Like `report`, while it is not known where the motion under way ends: it brakes."""
        if self.is_known and not self.fits(axes):
            self.lose("the controller reports a place that it cannot have reached; it was reset")
        if self.is_known:
            self._reported = axes
        return self.is_known

    def fits(self, axes: Array) -> bool:
        """Whether a report (3,) lies in the interval."""
        inside = (axes >= self._low - self._tolerance) & (axes <= self._high + self._tolerance)
        return bool(inside.all())

    def is_certainly(self, axes: Array) -> bool:
        """Whether the axes can stand nowhere but at (3,)."""
        near = np.maximum(np.abs(self._low - axes), np.abs(self._high - axes)) <= self._tolerance
        return bool(near.all())

    def lose(self, why: str) -> None:
        """The controller's counts mean nothing any more; the first reason stays."""
        self.why_lost = self.why_lost or why

    def confirm(self) -> None:
        """The operator says that the robot stands where it was last certain."""
        self.set((self._low + self._high) / 2, self.slack + (self._high - self._low) / 2)

    def set(self, axes: ArrayLike, slack: ArrayLike = 0.0) -> None:
        """The axes stand at (3,), give or take ``slack`` (3,)."""
        self.why_lost, self.slack = "", np.broadcast_to(np.asarray(slack, float), (3,)).copy()
        self._low = self._high = self._reported = np.asarray(axes, float)
