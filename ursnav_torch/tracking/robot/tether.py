"""How far from where it was last surely seen a scope can be, by what its robot tells.

A picture of featureless wall, or of a stone that hides it, is aligned nearly as well anywhere. A shaft that was not
driven there is not there: a place out of reach is none, until good alignments out of reach have followed each other for
so long that the sure place must have been the wrong one, or somebody moved the scope by hand.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.search.pose_mean import are_near

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TetherSettings:
    """How far a robot's word binds; mm at the kidney's scale 1.

    Attributes:
        reach_mm: so far may the scope be from where the robot's word puts it since it was last surely seen: breathing,
            a shaft that buckles, a tip that springs free. 3, 6, 8, 10 and 1000 mm give a place in 96.5, 98.5, 99.1,
            99.1 and 99.1 % of the choosing flights' pictures, 0.5 % of these more than 3 mm off
            (`benchmarks.flights phantoms=16 half=choosing odometry=true vary=tether.reach_mm=3,6,10,1000`). These meet
            few stones. Of the first 70 s of two choosing explorations in sight of one, 10.5 and 10.6 % of the pictures
            were told a place more than 3 mm off without a tether, of one of them 0.8 and 3.0 % with 8 and 10 mm
            (pictures kept and tracked again, by no command).
        reach_share: and so much of the way that the tip was driven since. 1.0 left 3.8 and 6.7 % of these two, 0.5 left
            0.8 and 1.3 % (with 6 mm, likewise).
        sure_above: a place counts as surely seen from this score of the alignment on. Set, as the two below.
        release_s: places out of reach, each aligned as well as ``sure_above``, that follow each other as the robot
            moved for so long are believed. inf binds for ever, 0 at the first.
        beyond_score: alignments out of reach are held back by this.
    """

    reach_mm: float = 8.0
    reach_share: float = 0.5
    sure_above: float = 0.65
    release_s: float = 3.0
    beyond_score: float = 0.15

    def __post_init__(self) -> None:
        if not (self.reach_mm > 0 and min(self.reach_share, self.release_s, self.beyond_score) >= 0):
            raise InputError(
                "A tether needs reach_mm > 0, and reach_share, release_s and beyond_score of at least 0; got "
                f"{self.reach_mm}, {self.reach_share}, {self.release_s} and {self.beyond_score}."
            )


class Tether:
    """Binds a track to where its robot can have brought the scope.

    Args:
        settings: lengths in mm of this kidney.
        same_mm, same_deg: poses no farther apart are one place.
    """

    def __init__(self, settings: TetherSettings, same_mm: float, same_deg: float) -> None:
        self._settings, self._same = settings, (same_mm, same_deg)
        self.reset()

    def reset(self) -> None:
        """The scope may be anywhere."""
        self._is_told = False
        self._sure: Array | None = None  # where it was last surely seen, carried on since
        self._driven_mm = 0.0  # how far the tip was driven since
        self._beyond: Array | None = None  # the last place out of reach, carried on
        self._beyond_since_s: float | None = None

    @property
    def binds(self) -> bool:
        """Whether any place is out of reach."""
        return self._sure is not None

    def carry(self, T_before_now: Array | None) -> None:
        """Go along with a motion (4, 4) that the robot told of; None: it told of none, so that nothing binds."""
        if T_before_now is None:
            self.reset()
            return
        self._is_told = True
        self._driven_mm += float(np.linalg.norm(T_before_now[:3, 3]))
        self._sure = None if self._sure is None else self._sure @ T_before_now
        self._beyond = None if self._beyond is None else self._beyond @ T_before_now

    def reaches(self, T_kidney_camera: Array) -> bool:
        """Whether the scope may be at a pose (4, 4)."""
        return bool(self.reached(T_kidney_camera[None])[0])

    def reached(self, T_kidney_camera: Array) -> NDArray[np.bool_]:
        """(N,) at which of some poses (N, 4, 4) the scope may be."""
        if self._sure is None:
            return np.ones(len(T_kidney_camera), bool)
        away = np.linalg.norm(T_kidney_camera[:, :3, 3] - self._sure[:3, 3], axis=1)
        return np.asarray(away <= self._settings.reach_mm + self._settings.reach_share * self._driven_mm)

    def against(self, T_kidney_camera: Array) -> Array:
        """(N,) what alignments at some poses (N, 4, 4) are held back by, in units of their score."""
        return np.asarray(self._settings.beyond_score * ~self.reached(T_kidney_camera), float)

    def see(self, T_kidney_camera: Array, score: float, t_s: float, believed: bool) -> None:
        """Take in how a picture is aligned, at a pose (4, 4), and whether that is believed to be the place."""
        s = self._settings
        if not self._is_told:
            return
        if self.reaches(T_kidney_camera):
            self._beyond = self._beyond_since_s = None
            if believed and score >= s.sure_above:
                self._sure, self._driven_mm = T_kidney_camera, 0.0
            return
        follows = self._beyond is not None and bool(are_near(self._beyond[None], T_kidney_camera, *self._same)[0])
        if score < s.sure_above or not follows or self._beyond_since_s is None:
            self._beyond_since_s = t_s
        self._beyond = T_kidney_camera
        if score >= s.sure_above and t_s - self._beyond_since_s >= s.release_s:
            self.reset()
