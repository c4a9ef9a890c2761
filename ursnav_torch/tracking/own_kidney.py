"""Whether the pictures show the VID's kidney at all, or another one: a sequential test, and a decoy to compare with.

The decoy is the same picture mirrored, which shows no kidney that there is.

How well a wrong kidney's picture fits depends on the picture: on fog, on skin, on how much is to be seen. A mirrored
picture has all of that in common with the picture and is of another kidney, so that its score tells what is to be
expected of a wrong one (target and decoy: Elias and Gygi, Nature Methods 4:207, 2007; cohort normalization in speaker
verification: Rosenberg et al., ICSLP 1992). Along a straight tube both fit alike, and neither kidney is spoken for.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.alignment import Refiner
from ursnav_torch.camera import Camera
from ursnav_torch.features import Features
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.tracking.filter import ViewFilter, with_incumbent
from ursnav_torch.tracking.motion import Hypotheses, Since
from ursnav_torch.tracking.pursuit import Pursuit, Weighed, expected
from ursnav_torch.tracking.settings import OwnKidneySettings, TrackSettings


@dataclass(frozen=True, slots=True)
class KidneyEvidence:
    """What one picture says.

    Attributes:
        score: of the refined pose, for the picture as it was taken: what was learned as the scope's pattern makes
            pictures of another kidney fit, too.
        fit: of the best view; where it is high there is much to be seen, and a true pose aligns well.
        decoy: score of the mirrored picture, which is asked while the kidney is in doubt; None else.
        off: standard deviations by which the pose misses the sensor's reading, None without one.
        relocated: whether the picture was located anew, and surely, see `tracking.relocalization`.
    """

    score: float
    fit: float
    decoy: float | None = None
    off: float | None = None
    relocated: bool = False

    def log_odds(self, settings: OwnKidneySettings) -> float:
        """That the picture shows the VID's kidney, within what a single picture may count."""
        s = settings
        if self.decoy is None:
            odds = float(np.dot(s.weights, (1.0, self.score, self.fit)))
        else:
            odds = float(np.dot(s.doubt_weights, (1.0, self.score, self.fit, self.decoy)))
        odds = s.independent * (odds + s.relocated_llr * self.relocated)
        told = 0.0 if self.off is None else float(np.clip(s.sensor_gate_sd - self.off, -s.sensor_llr, s.sensor_llr))
        return float(np.clip(odds, -s.max_llr_against, s.max_llr_for)) + told


class OwnKidneyTest:
    """A sequential test with bounds (Wald, Sequential tests of statistical hypotheses, 1945).

    Attributes:
        trust: the log-odds gathered so far, that this is the VID's kidney.
    """

    def __init__(self, settings: OwnKidneySettings) -> None:
        self._settings = settings
        self.trust = 0.0

    def add(self, evidence: KidneyEvidence, seconds: float) -> None:
        """Weigh one picture, taken some seconds after the one before."""
        s = self._settings
        gain = evidence.log_odds(s) * min(seconds, 4 * s.frame_s) / s.frame_s
        self.trust = float(np.clip(self.trust + gain, s.min_sum, s.max_sum))

    def leapt(self) -> None:
        """The place is another one: what spoke for the one before does not speak for it."""
        self.trust = min(self.trust, self._settings.after_leap)

    @property
    def in_doubt(self) -> bool:
        """Whether a picture's evidence needs a decoy."""
        return self.trust < self._settings.doubt_below

    @property
    def verdict(self) -> bool | None:
        """True when it is believed to be the VID's kidney, False when that is given up, None in between."""
        if self.trust <= self._settings.reject_below:
            return False
        return True if self.trust >= self._settings.accept_above else None


class Decoy:
    """Follows mirrored pictures as a track is followed that is looked for anew in every picture.

    Args:
        views: the VID's views, weighed as for the track itself.
        refiner: aligns poses with pictures.
        lumen: distances in the kidney.
        settings: those of the track, lengths in mm of this kidney.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    def __init__(
        self, views: ViewFilter, refiner: Refiner, lumen: LumenDistance, settings: TrackSettings, unit_mm: float = 1.0
    ) -> None:
        self._views, self._lumen, self._settings = views, lumen, settings
        self._pursuit = Pursuit(refiner, settings.challenger, settings.filter, unit_mm)
        self.reset()

    def reset(self) -> None:
        """Forget where mirrored pictures were."""
        self._pursuit.reset()
        self._before: Hypotheses | None = None
        self._at_s = 0.0

    def score(self, mirrored: Features, t_s: float) -> float:
        """How well the best pose found is aligned with a mirrored picture, whose features have maps.

        Args:
            mirrored: features of the picture, see `mirrored`.
            t_s: when it was taken; after a pause longer than tracks are bridged for, the decoy begins anew.
        """
        s, passed = self._settings, max(t_s - self._at_s, 1e-3)
        if passed > s.filter.bridge_s:
            self.reset()
        since = None if self._before is None else Since(self._before, passed, s.motion)
        found, fits = self._views.update(mirrored, since, None)
        prior = expected(since, None, s.challenger, self._lumen)
        refined = self._pursuit.follow(Weighed(mirrored, found, fits, prior, None), anew=True)
        share = s.filter.incumbent_share
        self._before, self._at_s = with_incumbent(found, refined.T_kidney_camera, share, self._lumen), t_s
        return refined.score


def mirrored(planes: Tensor, working_camera: Camera) -> Tensor:
    """Planes (P, H, W) of a picture as a mirror beside the scope would show them.

    Columns change places about the lens's axis, to the nearest pixel; a lens that is not the same on both sides of it
    is taken for one that is.
    """
    off_middle = round(2 * working_camera.cx - (planes.shape[-1] - 1))
    return torch.roll(planes.flip(-1), off_middle, -1)
