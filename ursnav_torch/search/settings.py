"""How the VID is searched: which cues count how much, which tilts are tried, how many views stay in the race."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching import Matching, Nearest, PairCost, ShapeContext


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """The search's cues, tilts and finalists; the same class for stills and for videos.

    A view's score is a weighted sum of up to three similarities, each 1 at best: the correlation of the relief, that
    of the edge directions, and 1 less the shape distance of the edge points.

    Attributes:
        relief_weight: weight of the relief's correlation; 0 compares no intensities at all.
        direction_weight: weight of the edge directions' correlation, shared by its channels.
        shape_weight: weight of the shape distance.
        tilt_step_deg, tilt_rounds: tilts tried: rings of directions this far apart around the picture's own.
        scan_finalists: views that the first scan, untilted, passes on to the scan at all tilts.
        finalists: views that the scan passes on to shape matching.
    """

    relief_weight: float = 1.0
    direction_weight: float = 2.0
    shape_weight: float = 2.0
    tilt_step_deg: float = 4.0
    tilt_rounds: int = 3
    scan_finalists: int = 256
    finalists: int = 32

    def __post_init__(self) -> None:
        weights = (self.relief_weight, self.direction_weight, self.shape_weight)
        if min(weights) < 0 or sum(weights) <= 0:
            raise InputError(f"Weights of relief, direction and shape must be >= 0 and not all 0, got {weights}.")
        if self.tilt_rounds < 0 or not self.tilt_step_deg > 0 or not 1 <= self.finalists <= self.scan_finalists:
            raise InputError(
                "A search needs tilt_step_deg > 0, tilt_rounds >= 0 and 1 <= finalists <= scan_finalists, got "
                f"{self.tilt_step_deg}, {self.tilt_rounds}, {self.finalists} and {self.scan_finalists}."
            )

    @property
    def map_weight(self) -> float:
        """Best sum of the scan's correlations."""
        return self.relief_weight + self.direction_weight

    def channel_weights(self, channels: int) -> Tensor:
        """Weights (C,) of the polar maps' channels: the relief, then pairs that share the directions' weight."""
        weight = torch.full((channels,), self.direction_weight * 2 / max(channels - 1, 1))
        weight[:1] = self.relief_weight
        return weight


#: For a video, whose motion says what a single picture's edge points would: fewer tilts, and no shape matching.
VIDEO_SEARCH = SearchSettings(shape_weight=0.0, tilt_step_deg=5.0, tilt_rounds=2)


def default_matching(both_sides: bool = False) -> Matching:
    """Shape contexts of 40 px reach with position and edge direction in the cost, query to view.

    With ``both_sides`` the view's points must be found in the query, too, which points on dark rims profit from, see
    `benchmarks.finalists`.
    """
    return Matching(
        ShapeContext(r_inner=5.0, r_outer=40.0, scale=1.0),
        PairCost(position_weight=1.0, direction_weight=1.0),
        Nearest("sum" if both_sides else "query_to_view", keep=1.0),
    )


def best_first(score: np.ndarray, count: int) -> np.ndarray:
    """Rows (min(count, N),) of the highest scores (N,), the highest first; of equals the first."""
    return np.argsort(-score, kind="stable")[:count]
