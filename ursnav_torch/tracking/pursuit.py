"""The track at hand: one refined pose taken on from picture to picture, beside a rival that may take over."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import Refined, Refiner
from ursnav_torch.alignment.light import Light
from ursnav_torch.alignment.refine import Prior
from ursnav_torch.features import Features
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.tracking.motion import Hypotheses
from ursnav_torch.tracking.place_search import SensorReading, TrackSettings, place

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Weighed:
    """A picture, and what the filter makes of it.

    Attributes:
        features: of the picture.
        found: the hypotheses, and ``fits`` (M,) how well each of them fits.
        prior: what motion says of poses, in units of the alignment's score.
        sensor: the EM reading, if there is one.
    """

    features: Features
    found: Hypotheses
    fits: Array
    prior: Prior
    sensor: SensorReading | None


@dataclass(frozen=True, slots=True)
class _Lead:
    """A track: its refined pose in the last picture and in the one before."""

    refined: Refined
    before: Refined | None = None

    def ahead(self) -> list[Array]:
        """Where the next pose may be: as far on as the last step led, or here."""
        here = self.refined.T_kidney_camera
        if self.before is None:
            return [here]
        on = here @ inverse(self.before.T_kidney_camera) @ here
        R = Rotation.from_matrix(on[:3, :3]).as_matrix()  # else rounding errors double from picture to picture
        return [transform_from(R, on[:3, 3]), here]


class Pursuit:
    """Follows one pose from picture to picture, and knows when another has been the better one for a while.

    Args:
        refiner: aligns poses with pictures.
        settings: see `TrackSettings`.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.

    Attributes:
        tries: poses that the track is tried to go on from.
    """

    def __init__(self, refiner: Refiner, settings: TrackSettings, unit_mm: float) -> None:
        self._refiner, self._settings, self._unit = refiner, settings, unit_mm
        self.tries = settings.tries
        self.reset()

    def reset(self) -> None:
        """Forget the track, and the scope's light."""
        self._light = Light()
        self._own: _Lead | None = None
        self._rival: _Lead | None = None
        self._good: Array | None = None  # last pose that was not shaky
        self._doubt, self._deeper = 0.0, 1.0

    @property
    def trusted(self) -> float:
        """1 while nothing speaks for a rival, 0 when it is about to take over."""
        return 1 - min(self._doubt / self._settings.convinced, 1.0)

    def follow(self, picture: Weighed, anew: bool) -> Refined:
        """The track's pose in the next picture.

        Where the filter holds another place more probable, or the track is aligned badly and another place fits, that
        is followed beside it, and becomes the track once it has been the better aligned for a while.

        Args:
            picture: the picture.
            anew: look for the track among all hypotheses.
        """
        s, T = self._settings, place(picture.found, self._settings, self._unit)
        if anew or self._own is None or self._own.refined.score < s.shaky:
            self._own = _Lead(self._aligned(picture, self._anywhere(picture, T), picture.prior))
            self._rival, self._doubt = None, 0.0
        else:
            agrees = self._near(T, self._own.refined.T_kidney_camera)
            around = self._around(self._own, T, picture.found)[: self.tries]
            self._own = _Lead(self._aligned(picture, around, picture.prior), self._own.refined)
            here = self._own.refined
            elsewhere: list[Array] = []
            if not agrees and not self._near(T, here.T_kidney_camera):
                elsewhere = [T]
            elif here.score < s.unsure:
                elsewhere = self._apart([here.T_kidney_camera], picture.found, picture.fits, 2)[1:]
            self._own = self._better(picture, self._own, elsewhere)
        refined = self._own.refined
        self._light.learn(refined.light, refined.score)
        if refined.score >= s.shaky:
            self._good = refined.T_kidney_camera
        return refined

    def _better(self, picture: Weighed, own: _Lead, elsewhere: list[Array]) -> _Lead:
        """The track, or the rival once it has been the better one; other places are aligned, and may be the rival."""
        s, before, sensor = self._settings, self._rival, picture.sensor
        tried = elsewhere if before is None else [*before.ahead(), *elsewhere]
        if not tried:
            self._doubt = max(self._doubt - 1.0, 0.0)
            return own
        found = self._aligned(picture, tried)
        if self._near(found.T_kidney_camera, own.refined.T_kidney_camera):
            self._rival, self._doubt = None, max(self._doubt - 1.0, 0.0)
            return own
        same = before is not None and self._near(found.T_kidney_camera, before.refined.T_kidney_camera)
        rival = _Lead(found, before.refined if before is not None and same else None)
        gain = (found.score - own.refined.score) / s.better_by
        if sensor is not None:
            off_own, off_rival = (sensor.off(lead.refined.T_kidney_camera[None])[0] for lead in (own, rival))
            gain += float(np.clip(off_own - off_rival, -1.0, 1.0))
        self._doubt = max((self._doubt if same else 0.0) + float(np.clip(gain, -1.0, s.most_gain)), 0.0)
        if self._doubt >= s.convinced:
            self._rival, self._doubt = None, 0.0
            return rival
        self._rival = None if gain < 0 and self._doubt == 0.0 else rival
        return own

    def _anywhere(self, picture: Weighed, T: Array) -> list[Array]:
        """What is known of the track, and the hypotheses that fit best or are most probable."""
        known = [] if self._own is None else [self._own.refined.T_kidney_camera]
        known += [] if self._good is None else [self._good]
        known += [] if self._rival is None else [self._rival.refined.T_kidney_camera]
        fitting = self._apart([*known, T], picture.found, picture.fits, self._settings.tries)
        return self._apart(fitting, picture.found, picture.found.weight, self._settings.tries + 3)

    def _apart(self, tried: list[Array], found: Hypotheses, worth: Array, count: int) -> list[Array]:
        """The poses given and the hypotheses of most worth (M,) that lie apart from them and each other, ``count``."""
        tried = list(tried)
        for pose in found.T_kidney_camera[np.argsort(-worth)]:
            if len(tried) < count and not any(self._near(pose, t) for t in tried):
                tried.append(pose)
        return tried

    def _around(self, own: _Lead, T: Array, found: Hypotheses) -> list[Array]:
        """Where the track may go on: ahead, a step deeper or less deep in turn, and places among the hypotheses nearby.

        Depth is what alignment tells least, and where it slips.
        """
        s, unit = self._settings, self._unit
        ahead = own.ahead()
        self._deeper = -self._deeper
        slid = ahead[-1].copy()
        slid[:3, 3] += self._deeper * s.slide_mm * unit * slid[:3, 2]
        tried = [*ahead, slid]
        order = np.argsort(-found.weight)[: s.newcomers]
        for pose in [T, *found.T_kidney_camera[order]]:
            apart = [np.linalg.norm(pose[:3, 3] - t[:3, 3]) for t in tried]
            if min(apart) > s.slide_mm / 2 * unit and apart[0] < 2 * s.near_mm * unit and len(tried) < s.tries:
                tried.append(pose)
        return tried

    def _aligned(self, picture: Weighed, candidates: list[Array], prior: Prior | None = None) -> Refined:
        return self._refiner.refine(picture.features, candidates, self._light.value, self._light.known, prior)

    def _near(self, T_a: Array, T_b: Array) -> bool:
        """Whether two poses are one place."""
        s = self._settings
        return bool(are_near(T_a[None], T_b, s.near_mm * self._unit, s.near_deg)[0])
