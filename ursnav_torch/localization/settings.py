"""How a picture's place is decided: the settings and their defaults."""

from dataclasses import dataclass

from ursnav_torch.errors import InputError
from ursnav_torch.matching import Matching, Nearest, PairCost, ShapeContext


def default_matching() -> Matching:
    """Shape contexts of 40 px reach with position and edge direction in the cost, query to view."""
    return Matching(
        ShapeContext(r_inner=5.0, r_outer=40.0, scale=1.0),
        PairCost(position_weight=1.0, direction_weight=1.0),
        Nearest(keep=1.0),
    )


@dataclass(frozen=True, slots=True)
class LocalizationSettings:
    """How a picture's place is decided.

    The distance of a view is a weighted mean of up to three: 1 - correlation of the relief, 1 - correlation of the
    edge directions, and the shape distance of the edge points.

    Attributes:
        relief_weight: weight of the relief's correlation; 0 compares no intensities at all.
        direction_weight: weight of the edge directions' correlation, shared by its channels.
        shape_weight: weight of the shape distance.
        tilted: views that the first scan, untilted, passes on to the scan at all tilts.
        tilt_step_deg, tilt_rounds: tilts tried: rings of directions this far apart around the picture's own.
        candidates: views that the scan passes on to shape matching.
        keep: candidates named in the answer.
        refine: whether the pose is refined beyond the nearest view.
        believe_refined: a refined pose whose score (see `Refined`) is lower has no say which place it is: it is
            at times far off.
        sure_refined: one whose score is lower is no better than the mean of the nearest views, and errs otherwise:
            where both are one place, the pose between them is the answer.
        accept: a confidence below this is "unsure".
    """

    relief_weight: float = 1.0
    direction_weight: float = 2.0
    shape_weight: float = 2.0
    tilted: int = 256
    tilt_step_deg: float = 4.0
    tilt_rounds: int = 3
    candidates: int = 32
    keep: int = 5
    refine: bool = True
    believe_refined: float = 0.6
    sure_refined: float = 0.65
    accept: float = 0.5

    def __post_init__(self) -> None:
        weights = (self.relief_weight, self.direction_weight, self.shape_weight)
        if min(weights) < 0 or sum(weights) <= 0:
            raise InputError(f"Weights of relief, direction and shape must be >= 0 and not all 0, got {weights}.")
        if not 1 <= self.keep <= self.candidates or not 0 <= self.accept <= 1:
            raise InputError(
                f"Expected 1 <= keep <= candidates and 0 <= accept <= 1, got keep={self.keep}, "
                f"candidates={self.candidates}, accept={self.accept}."
            )
