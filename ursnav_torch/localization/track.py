"""Following the scope through a video: a Bayesian filter over the views, and local refinement of the best pose.

The scope's pose is one of many hypotheses, each a view turned as the scan found it. A picture weighs them by how well
they fit, the motion model by how they follow from those before. Both work on all of the VID's views in every picture,
so the filter finds back by itself after a loss. Only past pictures are used.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import DefaultExtractor, DefaultSettings, Features
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.kidney import LumenDistance, observed_calyx
from ursnav_torch.localization.align_light import Light
from ursnav_torch.localization.motion import Hypotheses, MotionSettings
from ursnav_torch.localization.pattern import ScopePattern
from ursnav_torch.localization.refine import Refined, RefinementSettings, Refiner
from ursnav_torch.localization.smooth import PoseFilter, SmoothSettings
from ursnav_torch.localization.track_search import PlaceSearch, SensorReading, TrackSettings, place
from ursnav_torch.matching import one_thread_an_operation
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
TRACKING, LOST, SEARCHING = "tracking", "lost", "searching"
_NEGLIGIBLE = 1e-6  # hypotheses of less probability are not carried on


@dataclass(frozen=True, slots=True)
class Tracked:
    """One picture's answer.

    Attributes:
        state: ``tracking``, ``searching`` (no place leads yet) or ``lost`` (nothing fits as it should).
        T_kidney_camera: (4, 4), or None unless tracking.
        calyx: index of the calyx observed, -1 for none.
        confidence: probability of that calyx among the hypotheses.
        fit: of the best hypothesis to the picture, nan where that showed nothing.
        score: how well the refined pose is aligned, 1 is perfect; nan likewise.
        seconds: from picture to answer.
    """

    state: str
    T_kidney_camera: Array | None
    calyx: int
    confidence: float
    fit: float
    score: float
    seconds: float


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


class Tracker:
    """Follows the scope in one kidney, picture by picture.

    Args:
        vid: the views; their features must have maps (the default features have).
        lumen: distances along the lumen; made when None.
        settings, motion, smoothing, refinement: how to weigh, what moves how, and how poses are refined.

    Raises:
        InputError: the VID's features have no maps.
    """

    def __init__(
        self,
        vid: Vid,
        lumen: LumenDistance | None = None,
        settings: TrackSettings | None = None,
        motion: MotionSettings | None = None,
        smoothing: SmoothSettings | None = None,
        refinement: RefinementSettings | None = None,
    ) -> None:
        if not isinstance(vid.settings, DefaultSettings) or not vid.features.maps.numel():
            raise InputError(
                f"The VID {vid.folder} has features without maps, which tracking needs; build it with features=default."
            )
        self.vid, self.lumen = vid, lumen or LumenDistance.from_kidney(vid.kidney)
        self.settings, self.motion = settings or TrackSettings(), motion or MotionSettings()
        self._refiner = Refiner(
            vid, refinement or RefinementSettings(self.settings.tries + 3, iterations=6, fine_rounds=1), self.lumen
        )
        self._full_refinement, self._around_tries = self._refiner.settings, self.settings.tries
        self._smooth = PoseFilter(smoothing, vid.kidney.scale)
        self._extractor = DefaultExtractor(vid.settings, vid.camera)
        self._search = PlaceSearch(vid, self.lumen, self.settings, self.motion, self._extractor.working_camera)
        self.reset()

    def ease(self, level: int) -> None:
        """Spend less on every picture from now on, so that a slow machine keeps up; the track goes on.

        Args:
            level: 0 spends all that the settings say, 1 follows a good track by aligning two poses in a few steps
                instead of searching around it, 2 or more also weighs a third of the hypotheses.
        """
        full, refinement = self.settings, self._full_refinement
        few = max(full.hypotheses // 3, 2)
        self._around_tries = 2 if level else full.tries
        self._refiner.settings = replace(refinement, iterations=4) if level else refinement
        self._search.settings = replace(full, hypotheses=few, newcomers=max(few // 4, 1)) if level > 1 else full

    def reset(self) -> None:
        """Forget everything: the scope may be anywhere."""
        self._smooth.reset()
        self._before: Hypotheses | None = None
        self._at_s: float | None = None
        self._seen_s, self._trust, self._state = 0.0, 0.0, SEARCHING
        self._light = Light()
        self._pattern = ScopePattern(self._extractor, self.vid.kidney.scale)
        self._own: _Lead | None = None
        self._rival: _Lead | None = None
        self._good: Array | None = None  # last pose that was not shaky
        self._doubt, self._deeper = 0.0, 1.0

    def step(self, image: NDArray[np.uint8], t_s: float, sensor: SensorReading | None = None) -> Tracked:
        """The answer to the next picture, taken at ``t_s`` seconds; pictures are (H, W) or (H, W, 3) uint8.

        Raises:
            InputError: the picture cannot be of the VID's lens.
        """
        start = time.perf_counter()
        return self.follow(self.extract(image), t_s, sensor, start)

    def extract(self, image: NDArray[np.uint8]) -> Features | None:
        """What `follow` needs of a picture, None where it shows nothing; the one may run beside the other.

        Raises:
            InputError: see `step`.
        """
        with torch.inference_mode(), one_thread_an_operation():
            try:
                return self._extractor.extract(image)
            except FeatureError:
                return None

    def follow(
        self, features: Features | None, t_s: float, sensor: SensorReading | None = None, start: float | None = None
    ) -> Tracked:
        """`step` from what `extract` gave; the answer's seconds count from ``start``, on ``time.perf_counter``."""
        start = time.perf_counter() if start is None else start
        if features is None:
            return self._bridge(t_s, start)
        with torch.inference_mode(), one_thread_an_operation():
            return self._follow(features, t_s, sensor, start)

    def _follow(self, features: Features, t_s: float, sensor: SensorReading | None, start: float) -> Tracked:
        """The answer to a picture that shows something."""
        s, passed = self.settings, self.settings.usual_s if self._at_s is None else max(t_s - self._at_s, 1e-3)
        as_taken, features = features, self._pattern.removed(features)
        found, fits = self._search.weigh(features, self._before, passed, sensor)
        fit = float(fits[found.weight.argmax()])
        T, _ = place(found, s, self.vid.kidney.scale)
        refined = self._decide(features, T, found, fits, sensor)
        self._light.learn(refined.light, refined.score)
        if self._pattern.tells(refined.T_kidney_camera, refined.score):
            self._pattern.learn(as_taken, self._refiner.relief(refined), refined.T_kidney_camera)
        if refined.score >= s.shaky:
            self._good = refined.T_kidney_camera
        self._remember(found, refined.T_kidney_camera, t_s)
        plain = refined.score if features is as_taken else self._refiner.score(as_taken, refined)
        self._judge(refined, plain, found, passed, sensor)
        if self._state != TRACKING:
            self._smooth.reset()
            return Tracked(self._state, None, -1, 0.0, fit, refined.score, time.perf_counter() - start)
        T = self._steady(refined.T_kidney_camera, refined.score, t_s, sensor)
        calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        agree = observed_calyx(found.T_kidney_camera, self.vid.kidney, self.lumen) == calyx
        confidence = (0.5 + 0.5 * float(found.weight[agree].sum())) / (1 + np.exp(-self._trust))
        return Tracked(TRACKING, T, calyx, confidence, fit, refined.score, time.perf_counter() - start)

    def _decide(
        self, features: Features, T: Array, found: Hypotheses, fits: Array, sensor: SensorReading | None
    ) -> Refined:
        """Follow the track at hand; where the filter holds another place more probable, or the track is aligned badly
        and another place fits, follow that beside it, and go over to it once it has been the better aligned."""
        s = self.settings
        if self._own is None or self._state != TRACKING or self._own.refined.score < s.shaky:
            known = [] if self._own is None else [self._own.refined.T_kidney_camera]
            known += [] if self._good is None else [self._good]
            known += [] if self._rival is None else [self._rival.refined.T_kidney_camera]
            tried = self._apart([*known, T], found, fits, s.tries)
            tried = self._apart(tried, found, found.weight, s.tries + 3)
            self._own = _Lead(self._aligned(features, tried))
            self._rival, self._doubt = None, 0.0
            return self._own.refined
        agrees = self._near(T, self._own.refined.T_kidney_camera)
        around = self._around(self._own, T, found)[: self._around_tries]
        self._own = _Lead(self._aligned(features, around), self._own.refined)
        here = self._own.refined
        if not agrees and not self._near(T, here.T_kidney_camera):
            elsewhere = [T]
        elif here.score < s.unsure:
            elsewhere = self._apart([here.T_kidney_camera], found, fits, 2)[1:]
        else:
            elsewhere = []
        self._compare(features, elsewhere, sensor)
        return self._own.refined

    def _compare(self, features: Features, elsewhere: list[Array], sensor: SensorReading | None) -> None:
        """Align other places and the rival's; go over to the best of them once it has been better than the track."""
        s, before = self.settings, self._rival
        assert self._own is not None
        tried = elsewhere if before is None else [*before.ahead(), *elsewhere]
        if not tried:
            self._doubt = max(self._doubt - 1.0, 0.0)
            return
        found = self._aligned(features, tried)
        if self._near(found.T_kidney_camera, self._own.refined.T_kidney_camera):
            self._rival, self._doubt = None, max(self._doubt - 1.0, 0.0)
            return
        same = before is not None and self._near(found.T_kidney_camera, before.refined.T_kidney_camera)
        self._rival = _Lead(found, before.refined if before is not None and same else None)
        gain = (found.score - self._own.refined.score) / s.better_by
        if sensor is not None:
            own, rival = (sensor.off(lead.refined.T_kidney_camera[None])[0] for lead in (self._own, self._rival))
            gain += float(np.clip(own - rival, -1.0, 1.0))
        self._doubt = max((self._doubt if same else 0.0) + float(np.clip(gain, -1.0, s.most_gain)), 0.0)
        if self._doubt >= s.convinced:
            self._own, self._rival, self._doubt = self._rival, None, 0.0
        elif gain < 0 and self._doubt == 0.0:
            self._rival = None

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
        s, unit = self.settings, self.vid.kidney.scale
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

    def _aligned(self, features: Features, candidates: list[Array]) -> Refined:
        return self._refiner.refine(features, candidates, self._light.value, self._light.known)

    def _near(self, T_a: Array, T_b: Array) -> bool:
        """Whether two poses are one place."""
        return bool(self._near_all(T_a[None], T_b)[0])

    def _near_all(self, T_a: Array, T_b: Array) -> NDArray[np.bool_]:
        """Which poses (M, 4, 4) are one place with another."""
        s, apart = self.settings, np.linalg.norm(T_a[:, :3, 3] - T_b[:3, 3], axis=1)
        cosine = (np.einsum("mij,ij->m", T_a[:, :3, :3], T_b[:3, :3]) - 1) / 2
        near = (apart <= s.near_mm * self.vid.kidney.scale) & (cosine >= np.cos(np.radians(s.near_deg)))
        return np.asarray(near, bool)

    def _remember(self, found: Hypotheses, T: Array, t_s: float) -> None:
        """Keep the hypotheses, and the track's pose as one of them."""
        own = self.settings.own_share * (1 - min(self._doubt / self.settings.convinced, 1.0))
        kept = found.weight > _NEGLIGIBLE
        to_tips = np.concatenate([found.to_tips_mm[kept], self.lumen.to_calyces(T[None, :3, 3])])
        weight = np.append((1 - own) * found.weight[kept], own)
        self._before = Hypotheses(np.concatenate([found.T_kidney_camera[kept], T[None]]), to_tips, weight)
        self._at_s, self._seen_s = t_s, t_s

    def _judge(
        self, refined: Refined, score: float, found: Hypotheses, seconds: float, sensor: SensorReading | None
    ) -> None:
        """Weigh whether this is the VID's kidney: a sequential test with bounds (Wald 1945).

        ``score`` is the refined pose's for the picture as it was taken: what was learned as the scope's pattern makes
        pictures of another kidney fit, too.
        """
        s = self.settings
        agree = float(found.weight[self._near_all(found.T_kidney_camera, refined.T_kidney_camera)].sum())
        odds = s.own_kidney[0] + s.own_kidney[1] * score + s.own_kidney[2] * agree
        if sensor is not None:
            odds += float(np.clip(s.own_sensor - sensor.off(refined.T_kidney_camera[None])[0], -s.most, s.most))
        gain = float(np.clip(odds, -s.most, s.most_gain)) * min(seconds, 4 * s.usual_s) / s.usual_s
        self._trust = float(np.clip(self._trust + gain, -s.debt, s.credit))
        if self._trust <= -s.give_up:
            self._state = LOST
        elif self._trust >= s.believe:
            self._state = TRACKING

    def _steady(self, T: Array, score: float, t_s: float, sensor: SensorReading | None) -> Array:
        """The refined pose, smoothed; a pose far from where the motion leads starts a new track."""
        expected = self._smooth.predict(t_s)
        if expected is not None and not self._near(expected, T):
            if score < self.settings.shaky:
                return expected
            self._smooth.reset()
        T = self._smooth.update(T, t_s, score)
        if sensor is not None:
            at = sensor.position_mm - T[:3, :3] @ sensor.offset_camera_mm
            if np.linalg.norm(at - T[:3, 3]) <= 4 * sensor.sigma_mm:
                self._smooth.measure(at, sensor.sigma_mm)
                T = self._smooth.pose()
        return T

    def _bridge(self, t_s: float, start: float) -> Tracked:
        """The answer to a picture that shows nothing: where motion leads, for a while."""
        if self._state == TRACKING and t_s - self._seen_s > self.settings.bridge_s:
            self._state = SEARCHING
            self._smooth.reset()
        T = self._smooth.predict(t_s) if self._state == TRACKING else None
        if T is None:
            return Tracked(self._state, None, -1, 0.0, np.nan, np.nan, time.perf_counter() - start)
        calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        confidence = 0.5 ** ((t_s - self._seen_s) / self.settings.bridge_s) / (1 + np.exp(-self._trust))
        return Tracked(TRACKING, T, calyx, confidence, np.nan, np.nan, time.perf_counter() - start)
