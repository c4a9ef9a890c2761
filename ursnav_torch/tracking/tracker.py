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
from torch import Tensor

from ursnav_torch.alignment import Refined, RefinementSettings, Refiner
from ursnav_torch.alignment.refine import Prior
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import NO_MAPS, DefaultExtractor, DefaultSettings, EdgePoints, Features
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.matching import Matching
from ursnav_torch.scaling import scaled
from ursnav_torch.search import VIDEO_SEARCH, SearchSettings, ViewSearch
from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.tracking.belief import REGION_90, PoseBelief
from ursnav_torch.tracking.filter import ViewFilter
from ursnav_torch.tracking.motion import Hypotheses, transition
from ursnav_torch.tracking.odometry import Odometry, OdometryReading
from ursnav_torch.tracking.own_kidney import KidneyEvidence, OwnKidneyTest
from ursnav_torch.tracking.pattern import ScopePattern
from ursnav_torch.tracking.place_test import PlaceTest, calyx_set, region_sd_mm
from ursnav_torch.tracking.pursuit import Pursuit, Weighed
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
TRACKING, LOST, SEARCHING = "tracking", "lost", "searching"
#: Views that stand for all places in the lumen where a track may have strayed to.
_PLACES = 200
_NEGLIGIBLE = 1e-6  # hypotheses of less probability are not carried on


@dataclass(frozen=True, slots=True)
class Tracked:
    """One picture's answer.

    Attributes:
        state: ``tracking``, ``searching`` (no place leads yet) or ``lost`` (nothing fits as it should).
        T_kidney_camera: (4, 4) the most probable pose; a place that counts only while tracking. None where nothing is
            known, or the kidney is another.
        calyx: index of the calyx observed, -1 for none.
        confidence: probability of that calyx among the hypotheses.
        fit: of the best hypothesis to the picture, nan where that showed nothing.
        score: how well the refined pose is aligned, 1 is perfect; nan likewise.
        seconds: from picture to answer.
        T_aligned: (4, 4) the pose as it was aligned, believed or not, before any smoothing; None where the picture
            showed nothing.
        evidence: what the picture said on whether this is the kidney; None likewise.
        position_sd_mm: standard deviation of the position, an axis; 2.5 of it around the pose hold it in 90 % of cases.
        direction_sd_deg: of the viewing direction, either way aside; both nan without a pose.
        right: probability that the place is the right one.
        calyces: the fewest that hold the calyx observed with a probability of 0.95, -1 for none; empty without a pose.
    """

    state: str
    T_kidney_camera: Array | None
    calyx: int
    confidence: float
    fit: float
    score: float
    seconds: float
    T_aligned: Array | None = None
    evidence: KidneyEvidence | None = None
    position_sd_mm: float = np.nan
    direction_sd_deg: float = np.nan
    right: float = 0.0
    calyces: tuple[int, ...] = ()


class Tracker:
    """Follows the scope in one kidney, picture by picture.

    Args:
        vid: the views; their features must have maps (the default features have).
        settings: how to weigh and what moves how; lengths at the kidney's scale 1.
        search, matching: how the VID is searched; `VIDEO_SEARCH` when None.
        refinement: how poses are refined.

    Attributes:
        settings: as given, lengths in mm of this kidney.

    Raises:
        InputError: the VID's features have no maps.
    """

    def __init__(
        self,
        vid: Vid,
        settings: TrackSettings | None = None,
        search: SearchSettings | None = None,
        matching: Matching | None = None,
        refinement: RefinementSettings | None = None,
    ) -> None:
        if not isinstance(vid.settings, DefaultSettings) or not vid.features.maps.numel():
            raise InputError(
                f"The VID {vid.folder} has features without maps, which tracking needs; build it with features=default."
            )
        self.vid, self.lumen = vid, vid.lumen
        self.settings = s = scaled(settings or TrackSettings(), vid.kidney.scale)
        self._refiner = Refiner(
            vid, refinement or RefinementSettings(s.challenger.starts + 3, iterations=6, fine_rounds=1)
        )
        self._full_refinement = self._refiner.settings
        self._pursuit = Pursuit(self._refiner, s.challenger, s.filter)
        self._odometry, self._place = Odometry(s.odometry), PlaceTest(s.place)
        self._extractor = DefaultExtractor(vid.settings, vid.camera)
        self.working_camera = self._extractor.working_camera
        views = ViewSearch(vid, search or VIDEO_SEARCH, matching, self.working_camera)
        if not views.scans:
            raise InputError("Tracking compares polar maps, but relief_weight and direction_weight are both 0.")
        self._places = vid.T_kidney_camera[:: max(len(vid) // _PLACES, 1), :3, 3]
        self._filter = ViewFilter(views, vid.T_kidney_camera[:, :3, 3], self.lumen, s.filter, s.motion)
        self.reset()

    def described(self) -> str:
        """All settings in one line: two trackers of one VID that say the same give the same answers."""
        views = self._filter.search
        return f"{self.settings} {views.settings} {views.matching} {self._full_refinement}"

    def ease(self, level: int) -> None:
        """Spend less on every picture from now on, so that a slow machine keeps up; the track goes on.

        Args:
            level: 0 spends all that the settings say, 1 follows a good track by aligning two poses in a few steps
                instead of searching around it, 2 or more also weighs a third of the hypotheses.
        """
        full, refinement = self.settings.filter, self._full_refinement
        few = max(full.hypotheses // 3, 2)
        self._pursuit.starts = 2 if level else self.settings.challenger.starts
        self._refiner.settings = replace(refinement, iterations=4) if level else refinement
        self._filter.settings = replace(full, hypotheses=few, best_fitting=max(few // 4, 1)) if level > 1 else full

    def reset(self) -> None:
        """Forget everything: the scope may be anywhere."""
        self._belief: PoseBelief | None = None
        self._odometry.reset()
        self._place.reset()
        self._before: Hypotheses | None = None
        self._at_s: float | None = None
        self._seen_s = 0.0
        self._found: Hypotheses | None = None
        self._believed: bool | None = None
        self._aligned_before: Array | None = None
        self._test = OwnKidneyTest(self.settings.own_kidney)
        self._pattern = ScopePattern(self._extractor, self.vid.kidney.scale)
        self._pursuit.reset()

    def step(self, image: NDArray[np.uint8], t_s: float, sensor: SensorReading | None = None) -> Tracked:
        """The answer to the next picture, taken at ``t_s`` seconds; pictures are (H, W) or (H, W, 3) uint8.

        Raises:
            InputError: the picture cannot be of the VID's lens.
        """
        start = time.perf_counter()
        return self.follow(self.extract(image), t_s, sensor, start)

    def extract(self, image: NDArray[np.uint8]) -> Features | None:
        """What `follow` needs of a picture (H, W) or (H, W, 3), None where it shows nothing; both may run at once.

        Raises:
            InputError: see `step`.
        """
        with torch.inference_mode(), one_thread_an_operation():
            try:
                return self._extractor.extract(image)
            except FeatureError:
                return None

    def recall(self, relief: Tensor) -> Features:
        """What `follow` needs, from no more than the relief (h, w) of what `extract` gave, ``fields[0]``."""
        none = EdgePoints(torch.zeros(0, 2), torch.zeros(0), torch.zeros(0))
        kept = Features(none, NO_MAPS, np.zeros((0, 0), bool), relief[None])
        with torch.inference_mode(), one_thread_an_operation():
            return self._extractor.with_relief(kept, relief)

    def follow(
        self,
        features: Features | None,
        t_s: float,
        sensor: SensorReading | None = None,
        start: float | None = None,
        odometry: OdometryReading | None = None,
    ) -> Tracked:
        """`step` from what `extract` gave; the answer's seconds count from ``start``, on ``time.perf_counter``."""
        start = time.perf_counter() if start is None else start
        passed = self.settings.own_kidney.frame_s if self._at_s is None else max(t_s - self._at_s, 1e-3)
        motion = None if odometry is None else self._odometry.motion(odometry, passed)
        self._place.passed(passed)
        if self._belief is not None:
            blind = features is None or self._place.right < self.settings.place.anew_below
            self._belief = self._belief.predicted(t_s, self.settings.belief, motion, blind)
        self._at_s = t_s
        if features is None:
            return self._answer(None, np.nan, np.nan, None, start)
        with torch.inference_mode(), one_thread_an_operation():
            return self._follow(features, passed, sensor, start)

    def _follow(self, features: Features, passed: float, sensor: SensorReading | None, start: float) -> Tracked:
        """The answer to a picture that shows something."""
        as_taken, features = features, self._pattern.removed(features)
        since = passed if self._at_s is None else max(self._at_s - self._seen_s, passed)
        found, fits = self._filter.update(features, self._before, since, sensor)
        self._found = found
        fit = float(fits[found.weight.argmax()])
        picture = Weighed(features, found, fits, self._expected(since, sensor), sensor, self._belief)
        anew = self._belief is None or self._place.right < self.settings.place.anew_below
        refined = self._pursuit.follow(picture, anew)
        if self._pattern.tells(refined.T_kidney_camera, refined.score):
            self._pattern.learn(as_taken, self._refiner.relief(refined), refined.T_kidney_camera)
        self._remember(found, refined.T_kidney_camera)
        plain = refined.score if features is as_taken else self._refiner.score(as_taken, refined)
        evidence = self._judge(picture, refined.T_kidney_camera, plain, passed)
        self._measure(features, refined, self._place.llr(evidence), passed, sensor)
        return self._answer(refined.T_kidney_camera, fit, refined.score, evidence, start)

    def _measure(
        self, features: Features, refined: Refined, llr: float, passed: float, sensor: SensorReading | None
    ) -> None:
        """Take an aligned pose into the belief, as far as the picture's log-likelihood ratio lets it.

        A pose at another place begins a new belief, if it is aligned well or the old one is given up; else the belief
        coasts on motion alone.
        """
        assert self._at_s is not None
        T, s, before = refined.T_kidney_camera, self.settings, self._belief
        covariance = s.belief.measured(self._refiner.information(features, refined), refined.score)
        covariance *= 1 + np.exp(-llr)
        if before is not None and self._near(before.T_kidney_camera[None], T)[0]:
            self._belief, _ = before.updated(T, covariance)
            self._place.add(llr, passed)
            if self._aligned_before is not None and self._place.right > s.place.sure:
                sd = np.sqrt(np.diag(covariance))
                self._odometry.learn(self._aligned_before, T, float(sd[2]), float(sd[3:5].max()), passed)
        elif before is None or llr > 0 or self._place.right < s.place.anew_below:
            self._belief = PoseBelief.first(T, covariance, self._at_s, s.belief)
            self._place.reset()
            self._place.add(llr, passed)
        else:
            self._place.add(max(llr, s.place.coasting_llr), passed)
        self._aligned_before = T
        assert self._belief is not None
        at = None if sensor is None else sensor.camera_at(self._belief.T_kidney_camera)
        if sensor is not None and at is not None:
            self._belief = self._belief.measured_place(at, sensor.sigma_mm)

    def _answer(
        self, T_aligned: Array | None, fit: float, score: float, evidence: KidneyEvidence | None, start: float
    ) -> Tracked:
        """What is believed now, and whether that is a place."""
        belief, s = self._belief, self.settings
        if self._test.verdict is not None:
            self._believed = self._test.verdict
        if belief is None or self._believed is False:
            state = LOST if self._believed is False else SEARCHING
            return Tracked(state, None, -1, 0.0, fit, score, time.perf_counter() - start, T_aligned, evidence)
        T, right = belief.T_kidney_camera, self._place.right
        others = self._elsewhere(T)
        anywhere = np.linalg.norm(self._places - T[:3, 3], axis=1)
        sd = region_sd_mm(right, belief.position_sd_mm, others.away_mm, others.weight, anywhere, s.place.strayed)
        certain = bool(self._believed) and right >= s.place.sure and sd * REGION_90 <= s.place.largest_mm
        calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        calyces = calyx_set(calyx, right, others.calyx, others.weight)
        confidence = right * others.agreeing(calyx) / (1 + np.exp(-self._test.trust))
        return Tracked(
            TRACKING if certain else SEARCHING, T, calyx, confidence, fit, score, time.perf_counter() - start,
            T_aligned, evidence, sd, belief.direction_sd_deg, right, tuple(calyces),
        )  # fmt: skip

    def _elsewhere(self, T: Array) -> "_Others":
        """The hypotheses, beside a pose (4, 4)."""
        found = self._found
        if found is None:
            return _Others(np.zeros(0), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
        other = ~self._near(found.T_kidney_camera, T)
        away = np.linalg.norm(found.T_kidney_camera[other, :3, 3] - T[:3, 3], axis=1)
        calyx = observed_calyx(found.T_kidney_camera, self.vid.kidney, self.lumen)
        return _Others(away, calyx[other], found.weight[other], np.stack([calyx, found.weight]))

    def _expected(self, seconds: float, sensor: SensorReading | None) -> Prior:
        """What motion since the picture before, and the sensor, say of poses, in units of the alignment's score."""
        s, before, motion = self.settings.challenger, self._before, self.settings.motion

        def prior(T: Array) -> Array:
            log = np.zeros(len(T))
            if before is not None:
                log = transition(before, T, self.lumen.to_calyces(T[:, :3, 3]), seconds, motion)
                log = np.maximum(log - log.max(), -s.score_step / s.prior_weight)
            if sensor is not None:
                log = log + sensor.log_probability(T)
            return s.prior_weight * log

        return prior

    def _remember(self, found: Hypotheses, T: Array) -> None:
        """Keep the hypotheses, and the track's pose as one of them."""
        own = self.settings.filter.incumbent_share * self._pursuit.trusted
        kept = found.weight > _NEGLIGIBLE
        to_tips = np.concatenate([found.to_tips_mm[kept], self.lumen.to_calyces(T[None, :3, 3])])
        weight = np.append((1 - own) * found.weight[kept], own)
        self._before = Hypotheses(np.concatenate([found.T_kidney_camera[kept], T[None]]), to_tips, weight)
        self._seen_s = 0.0 if self._at_s is None else self._at_s

    def _judge(self, picture: Weighed, T: Array, score: float, seconds: float) -> KidneyEvidence:
        """Weigh a picture aligned at a pose (4, 4): is this the kidney, and the place? The score is as it was taken."""
        near = self._near(picture.found.T_kidney_camera, T)
        worst = float(picture.fits.min())  # what was not kept fits no better
        here, elsewhere = (float(picture.fits[at].max(initial=worst)) for at in (near, ~near))
        off = None if picture.sensor is None else float(picture.sensor.off(T[None])[0])
        evidence = KidneyEvidence(score, here - elsewhere, max(here, elsewhere), off)
        self._test.add(evidence, seconds)
        return evidence

    def _near(self, T_a: Array, T_b: Array) -> NDArray[np.bool_]:
        """Which poses (K, 4, 4) are one place with another."""
        s = self.settings.filter
        return are_near(T_a, T_b, s.same_place_mm, s.same_place_deg)


@dataclass(frozen=True, slots=True)
class _Others:
    """The hypotheses at other places than the track's.

    Attributes:
        away_mm, calyx, weight: (M,) how far they are, the calyx that each observes, and how probable they are.
        votes: (2, N) calyx and weight of all hypotheses.
    """

    away_mm: Array
    calyx: NDArray[np.int64]
    weight: Array
    votes: Array

    def agreeing(self, calyx: int) -> float:
        """Share of the hypotheses' votes for a calyx, halfway to all of them."""
        if not self.votes.size:
            return 1.0
        return 0.5 + 0.5 * float(self.votes[1, self.votes[0] == calyx].sum())
