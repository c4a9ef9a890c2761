"""The space that a scope has: the lumen, less the stones that pictures told of."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.kidney import LumenDistance
from ursnav_torch.stones import THERE, FoundStone

Array = NDArray[np.float64]


class FreeSpace:
    """Distances to whatever may be in the way.

    Args:
        lumen: the walls.

    Attributes:
        lumen: see there.
        stones: those that pictures told of until now; of them, those that are there are in the way.
    """

    def __init__(self, lumen: LumenDistance) -> None:
        self.lumen = lumen
        self.stones: tuple[FoundStone, ...] = ()

    @property
    def scale(self) -> float:
        """The kidney's."""
        return self.lumen.scale

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance in mm from points (N, 3), kidney frame, to the nearest wall or stone; negative in either."""
        points = np.asarray(points_mm, float).reshape(-1, 3)
        room = self.lumen.clearance_mm(points)
        for stone in self.stones:
            if stone.state == THERE:
                room = np.minimum(room, np.linalg.norm(points - stone.center_mm, axis=1) - stone.size_mm / 2)
        return room
