"""What autonomy is told and what it answers: plain values, so that it knows no device."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.stones import FoundStone

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Perception:
    """What is known at one moment.

    Attributes:
        t_s: now.
        T_kidney_camera: (4, 4) the newest pose that was believed; None while there is none.
        seen_s: when the last picture was taken that showed it; since then it is only expected.
        calyces: indices of the calyces that this picture may show; empty where it shows none.
        position_sd_mm: how far off the position may be, two of three times; None where nobody says.
        bend_rad: (2,) the bend about x and y that the robot reports.
        insertion_mm: the insertion that it reports.
        slack_mm: play of the robot's slider, learned from pictures; None where nobody says.
        glare: share of the newest picture that is too bright to show anything.
        stones: those that pictures told of until now.
    """

    t_s: float
    T_kidney_camera: Array | None = None
    seen_s: float = 0.0
    calyces: tuple[int, ...] = ()
    position_sd_mm: float | None = None
    bend_rad: Array = field(default_factory=lambda: np.zeros(2))
    insertion_mm: float = 0.0
    slack_mm: float | None = None
    glare: float = 0.0
    stones: tuple[FoundStone, ...] = ()

    def is_known(self, newest_s: float, sd_mm: float) -> bool:
        """Whether the place is known, by a picture no older than ``newest_s``, to within a standard deviation."""
        is_new = self.T_kidney_camera is not None and self.t_s - self.seen_s <= newest_s
        return is_new and (self.position_sd_mm is None or self.position_sd_mm <= sd_mm)


@dataclass(frozen=True, slots=True)
class Permission:
    """Whether autonomy may move: the dead-man button is held and the robot armed; a stop ends everything."""

    held: bool = False
    armed: bool = False
    stopped: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Wish:
    """How the joints shall move: bend rates (2,) in radians a second, and insertion in mm a second."""

    bend_rad_s: Array = field(default_factory=lambda: np.zeros(2))
    insertion_mm_s: float = 0.0

    @property
    def is_still(self) -> bool:
        """Whether nothing shall move."""
        return not (self.bend_rad_s.any() or self.insertion_mm_s)
