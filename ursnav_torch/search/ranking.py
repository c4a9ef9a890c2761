"""What a search gives: hypotheses, one a view, each with the pose that the picture has there."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.matching import Assignment

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ranking:
    """Poses that a picture may have been taken from.

    Attributes:
        views: (K,) int64 rows of the VID.
        score: (K,) weighted sum of the cues' similarities, higher is better.
        best_score: what a perfect fit would score.
        R_view_query: (K, 3, 3) how the picture's camera is turned against each view's, roll and tilt:
            ``ray in the view's camera = R_view_query @ ray in the picture's``.
        T_kidney_camera: (K, 4, 4) the picture's pose: the view's place, turned by ``R_view_query``.
        assignment: of the picture's edge points to each view's; None where shapes were not compared.
    """

    views: NDArray[np.int64]
    score: Array
    best_score: float
    R_view_query: Array
    T_kidney_camera: Array
    assignment: Assignment | None = None

    @property
    def distance(self) -> Array:
        """(K,) lower is nearer, 0 is a perfect fit."""
        return 1 - self.score / self.best_score

    def __len__(self) -> int:
        return len(self.views)

    def at(self, rows: NDArray[np.int64]) -> "Ranking":
        """The hypotheses at some rows (N,), in that order."""
        chosen = self.assignment
        if chosen is not None:
            at = torch.from_numpy(rows)
            chosen = Assignment(chosen.distance[at], chosen.view_point[at], chosen.strength[at])
        R, T = self.R_view_query[rows], self.T_kidney_camera[rows]
        return Ranking(self.views[rows], self.score[rows], self.best_score, R, T, chosen)


def view_from_query(roll: Array, R_query_tilted: Array) -> Array:
    """Rotations R_view_query (K, 3, 3) from rolls and tilts: the one place where the two are put together.

    Args:
        roll: (K,) radians about the optical axis, x towards y: ``T_kidney_tilted = T_kidney_view @ Rz(roll)``.
        R_query_tilted: (K, 3, 3) or (3, 3), how the tilted camera is turned against the picture's own.
    """
    about_axis = np.zeros((len(roll), 3, 3))
    about_axis[:, 0, 0] = about_axis[:, 1, 1] = np.cos(roll)
    about_axis[:, 1, 0] = np.sin(roll)
    about_axis[:, 0, 1] = -about_axis[:, 1, 0]
    about_axis[:, 2, 2] = 1.0
    return about_axis @ np.swapaxes(R_query_tilted, -1, -2)
