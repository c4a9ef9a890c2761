"""The path so far, in bounded memory."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Trail:
    """Places passed, in order; places nearer than ``step_mm`` to the last are left out.

    When ``most`` are held, every second one is dropped and the step doubled, so a long session costs no more.
    """

    def __init__(self, step_mm: float = 0.5, most: int = 4000) -> None:
        self.step_mm, self._most = step_mm, most
        self._points, self._length = np.zeros((most, 3)), 0

    def add(self, position_mm: Array) -> None:
        """Add a place (3,)."""
        if self._length and np.linalg.norm(position_mm - self._points[self._length - 1]) < self.step_mm:
            return
        if self._length == self._most:
            kept = self._points[::2]
            self._points = np.zeros((self._most, 3))  # views given out keep the old array
            self._points[: len(kept)], self._length = kept, len(kept)
            self.step_mm *= 2
        self._points[self._length] = position_mm
        self._length += 1

    def points(self) -> Array:
        """(N, 3) all places so far; a view that stays as it is."""
        return self._points[: self._length]
