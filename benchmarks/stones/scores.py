"""Stones found beside stones there are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.stones.flights import StoneFlight
from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import Array
from ursnav_torch.stones import FoundStone, StoneMap, StoneMapSettings

#: What is found within this of a stone's surface is that stone, mm.
NEAR_MM = 3.0
#: A stone was shown that covered this share of the picture in so many pictures.
SHOWN_SHARE, SHOWN_PICTURES = 0.02, 2
#: Pose (4, 4) and standard deviations (mm, radians) of a picture by its number; None: no place.
Poses = Callable[[int], tuple[Array, tuple[float, float]] | None]


@dataclass(slots=True)
class Score:
    """What was counted over flights.

    Attributes:
        kidneys: flights.
        there, shown: stones, and those of them that the flight showed, see `SHOWN_SHARE`.
        found, found_shown: of each.
        false: stones told that are none.
        off_mm, size_share: of those found: error of the place, and of the size as a share of it.
        sd_mm, size_sd_share: what was said of those.
        right_calyx: of those found.
    """

    kidneys: int = 0
    there: int = 0
    shown: int = 0
    found: int = 0
    found_shown: int = 0
    false: int = 0
    off_mm: list[float] = field(default_factory=list)
    size_share: list[float] = field(default_factory=list)
    sd_mm: list[float] = field(default_factory=list)
    right_calyx: list[bool] = field(default_factory=list)

    def add(self, flight: StoneFlight, told: Sequence[FoundStone], calyx_of: Callable[[Array], int]) -> None:
        """Take in a flight's true stones and those that were told."""
        truth = flight.stones
        shown = (flight.shown >= SHOWN_SHARE).sum(0) >= SHOWN_PICTURES
        gap = np.array([[np.linalg.norm(f.center_mm - t.center_mm) - t.radii_mm.max() for t in truth] for f in told])
        gap = gap.reshape(len(told), len(truth))
        pairs = [(i, j) for i, j in zip(*linear_sum_assignment(gap), strict=True) if gap[i, j] < NEAR_MM]
        self.kidneys += 1
        self.there, self.shown = self.there + len(truth), self.shown + int(shown.sum())
        self.found, self.false = self.found + len(pairs), self.false + len(told) - len(pairs)
        self.found_shown += sum(bool(shown[j]) for _, j in pairs)
        for i, j in pairs:
            size = 2 * float(truth[j].radii_mm.max())
            self.off_mm.append(float(np.linalg.norm(told[i].center_mm - truth[j].center_mm)))
            self.size_share.append(told[i].size_mm / size - 1)
            self.sd_mm.append(told[i].position_sd_mm)
            self.right_calyx.append(told[i].calyx == calyx_of(truth[j].center_mm))


def mapped(
    flight: StoneFlight,
    bodies: Sequence[tuple[ForegroundBody, ...]],
    poses: Poses,
    working_camera: Camera,
    settings: StoneMapSettings,
) -> StoneMap:
    """The map of stones after a flight."""
    stones = StoneMap(flight.kidney, flight.lumen, working_camera, settings)
    for i, seen in enumerate(bodies):
        place = poses(i)
        if place is not None:
            stones.add(place[0], seen, float(flight.t_s[i]), i, place[1])
    return stones
