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

from ursnav_torch.alignment import Refined, RefinementSettings, Refiner
from ursnav_torch.alignment.refine import Prior
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Features
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import inverse
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.matching import Matching
from ursnav_torch.scaling import scaled
from ursnav_torch.search import VIDEO_SEARCH, SearchSettings, ViewSearch
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.tracking.certainty import TrackCertainty, track_certainty, track_evidence, track_weights
from ursnav_torch.tracking.course import Course
from ursnav_torch.tracking.filter import ViewFilter, with_incumbent
from ursnav_torch.tracking.motion import Hypotheses, Since, likeliest_places
from ursnav_torch.tracking.own_kidney import Decoy, KidneyEvidence, OwnKidneyTest
from ursnav_torch.tracking.pattern import KnownBodies, ScopePattern
from ursnav_torch.tracking.pursuit import Pursuit, Weighed, expected
from ursnav_torch.tracking.reading import TrackReader
from ursnav_torch.tracking.relocalization import Relocalizer, Relocated
from ursnav_torch.tracking.robot.dead_reckoning import DeadReckoning
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.robot.tether import Tether
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, TrackSettings
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
TRACKING, LOST, SEARCHING = "tracking", "lost", "searching"
_SAME_TIME_S = 1e-3


@dataclass(frozen=True, slots=True)
class Tracked:
    """One picture's answer.

    Attributes:
        state: ``tracking``, ``searching`` (no place leads yet, or the pose may be too far off to be one) or ``lost``
            (nothing fits as it should).
        T_kidney_camera: (4, 4) while tracking, or while searching about it; else None.
        calyx: index of the calyx observed, -1 for none.
        confidence: probability of that calyx among the hypotheses.
        fit: of the best hypothesis to the last picture that was weighed against all views, nan where a picture showed
            nothing.
        score: how well the refined pose is aligned, 1 is perfect; nan likewise.
        seconds: from picture to answer.
        T_aligned: (4, 4) the pose as it was aligned, believed or not, before any smoothing; None where the picture
            showed nothing.
        evidence: what the picture said on whether this is the kidney; None where it was not weighed against all views.
        certainty: the calyces that it may be, and how far off the pose may be; None without a pose.
        places: (K, 4) x, y, z in the kidney frame and probability of the likeliest hypotheses, to be looked at.
        bodies: stones and instruments before the wall in the picture.
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
    certainty: TrackCertainty | None = None
    places: Array | None = None
    bodies: tuple[ForegroundBody, ...] = ()

    @property
    def position_sd_mm(self) -> float | None:
        """How far off the position may be, two of three times; None without a pose."""
        return None if self.certainty is None else self.certainty.position_sd_mm

    @property
    def is_settled(self) -> bool:
        """Whether the picture was seen, not only expected, and can be of one calyx alone."""
        seen = self.state == TRACKING and bool(np.isfinite(self.score))
        return seen and (self.certainty is None or len(self.certainty.calyces) == 1)


def video_refinement(starts: int = ChallengerSettings().starts) -> RefinementSettings:
    """How poses are aligned in a video, with as many starts as a track has and those of one that is looked for anew.

    The water's glow is carried from picture to picture, so that it is held more than a still's. Flights are followed
    alike with a spread of 0.4 (`benchmarks.flights half=choosing vary=alignment.water_spread=0.4`), but mirrored
    pictures of drawn tubes then fit nearly as well as the true ones.
    """
    most = starts + 3
    return RefinementSettings(most, iterations=6, fine_rounds=1, at_first=most, verify=False, water_spread=0.12)


class Tracker:
    """Follows the scope in one kidney, picture by picture.

    Args:
        vid: the views; their features must have maps (the default features have).
        settings: how to weigh and what moves how; lengths at the kidney's scale 1.
        search, matching: how the VID is searched; `VIDEO_SEARCH` when None.
        refinement: how poses are refined.

    Attributes:
        settings: as given, lengths in mm of this kidney.
        known: what is known to lie before the wall, wherever the scope is; told by who maps stones.

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
        self._refiner = Refiner(vid, refinement or video_refinement(s.challenger.starts))
        self._full_refinement, self._weights = self._refiner.settings, track_weights()
        self._pursuit = Pursuit(self._refiner, s.challenger, s.filter, vid.kidney.scale)
        self._course, self._robot = Course(s), DeadReckoning(s.odometry, self.lumen, vid.kidney.scale)
        self._tether = Tether(s.tether, s.filter.same_place_mm, s.filter.same_place_deg)
        self._reader = TrackReader(vid.settings, vid.camera, s.reading.learned)
        self.working_camera = self._reader.working_camera
        views = ViewSearch(vid, search or VIDEO_SEARCH, matching, self.working_camera)
        if not views.scans:
            raise InputError("Tracking compares polar maps, but relief_weight and direction_weight are both 0.")
        self._filter = ViewFilter(views, vid.T_kidney_camera[:, :3, 3], self.lumen, s.filter, s.motion.spacing_mm)
        self.known = KnownBodies(self.lumen, vid.kidney.scale)
        self._relocalizer = Relocalizer(vid) if np.isfinite(s.relocalization.above_mm) else None
        self._relocates = True
        self._decoy = Decoy(self._filter, self._refiner, self.lumen, s, vid.kidney.scale)
        self.reset()

    def described(self) -> str:
        """All settings in one line: two trackers of one VID that say the same give the same answers."""
        views = self._filter.search
        return f"{self.settings} {views.settings} {views.matching} {self._full_refinement}"

    @property
    def shown(self) -> NDArray[np.bool_] | None:
        """(H, W) the part of the lens's picture that shows the scene, as far as is known; None for all of it."""
        return self._reader.shown

    @property
    def slider_play_mm(self) -> float | None:
        """Width of the slider's play as pictures have shown it; None where no robot tells where it stands."""
        return self._robot.slider_play_mm

    def ease(self, level: int) -> None:
        """Spend less on every picture from now on, so that a slow machine keeps up; the track goes on.

        Args:
            level: 0 spends all that the settings say, 1 follows a good track by aligning two poses in a few steps
                and searches half as often, 2 or more also weighs a third of the hypotheses and locates no picture anew.
        """
        full, refinement = self.settings.filter, self._full_refinement
        few = max(full.hypotheses // 3, 2)
        challenger = self.settings.challenger
        self._pursuit.starts = 2 if level else challenger.starts
        self._pursuit.catches = challenger.catches // 2 if level else challenger.catches
        self._refiner.settings = replace(refinement, iterations=4) if level else refinement
        seldom = replace(full, every_s=2 * full.every_s) if level else full
        self._relocates = level < 2
        self._filter.settings = replace(seldom, hypotheses=few, best_fitting=max(few // 4, 1)) if level > 1 else seldom

    def reset(self) -> None:
        """Forget everything: the scope may be anywhere."""
        self._course.reset()
        self._robot.reset()
        self._tether.reset()
        self._aligned: Refined | None = None  # the pose in the last picture, where that showed something
        self._before: Hypotheses | None = None
        self._at_s: float | None = None
        self._looked_s: float | None = None  # when a picture was last weighed against all views
        self._found: Hypotheses | None = None  # what that left, carried along since
        self._fit = np.nan
        self._seen_s, self._state = 0.0, SEARCHING
        self._sure: TrackCertainty | None = None
        self._test = OwnKidneyTest(self.settings.own_kidney)
        self._is_sure = False  # whether this track has been beyond doubt
        self._pattern = ScopePattern(self.vid.kidney.scale)
        self._pursuit.reset()
        self._decoy.reset()
        self._reader.reset()

    def step(
        self,
        image: NDArray[np.uint8],
        t_s: float,
        sensor: SensorReading | None = None,
        odometry: OdometryReading | None = None,
    ) -> Tracked:
        """The answer to the next picture, taken at ``t_s`` seconds; pictures are (H, W) or (H, W, 3) uint8.

        Raises:
            InputError: the picture cannot be of the VID's lens.
        """
        start = time.perf_counter()
        return self.follow(self.extract(image), t_s, sensor, start, odometry, image)

    def extract(self, image: NDArray[np.uint8], edges: bool = False) -> Features | None:
        """What `follow` needs of a picture (H, W) or (H, W, 3), None where it shows nothing; both may run at once.

        Args:
            image: the picture.
            edges: whether somebody wants to see its edge points, which are left out where the search reads none.

        Raises:
            InputError: see `step`.
        """
        return self._reader.read(image, self._filter.search.reads_edges, shown=edges)

    def narrow(self, scene: NDArray[np.bool_]) -> None:
        """From now on pictures show the scene in a part (H, W) of the lens alone."""
        self._reader.narrow(scene)
        if self._relocalizer is not None:
            self._relocalizer.narrow(scene)

    def follow(
        self,
        features: Features | None,
        t_s: float,
        sensor: SensorReading | None = None,
        start: float | None = None,
        odometry: OdometryReading | None = None,
        image: NDArray[np.uint8] | None = None,
    ) -> Tracked:
        """`step` from what `extract` gave; the answer's seconds count from ``start``, on ``time.perf_counter``.

        Without the ``image`` (H, W) or (H, W, 3) no picture is located anew, see `relocalization`.
        """
        start = time.perf_counter() if start is None else start
        self._robot.hear(odometry, t_s)
        step = self._robot.step if sensor is None else None  # a sensor tells better
        self._tether.carry(None if step is None else step.T_before_now)
        if features is None:
            self._aligned = None
            return self._bridge(t_s, start)
        with torch.inference_mode(), one_thread_an_operation():
            return replace(self._follow(self._left_out(features), t_s, sensor, start, image), bodies=features.bodies)

    def _left_out(self, features: Features) -> Features:
        """Features without what is known to hide the wall from where a track goes on."""
        T, step = self._course.pose() if self._state == TRACKING else None, self._robot.step
        if T is None:
            return features
        T = T if step is None else T @ step.T_before_now
        return self.known.left_out(features, T, self.working_camera, self._reader.lens_mask)

    def _told_places(self, t_s: float) -> tuple[Array, ...]:
        """Go on to the time of a picture: where (4, 4) a robot's word puts the camera, see `Weighed`; else nothing."""
        step = self._robot.step
        ahead = self._course.predict(t_s, step)
        return () if step is None or ahead is None else (ahead, *self._robot.expected())

    def _learn(self, as_taken: Features, refined: Refined, passed: float) -> None:
        """Learn from a picture as aligned what the scope adds to pictures, and how its robot moves it; from one whose
        alignment is not believed, nothing.
        """
        believed = not self._course.coasts
        if believed and self._pattern.tells(refined.T_kidney_camera, refined.score):
            self._pattern.learn(as_taken, self._refiner.relief(refined), refined.T_kidney_camera)
        if believed:
            self._learn_plays(refined, passed)
        self._aligned = refined if believed else None
        self._robot.seen()

    def _learn_plays(self, refined: Refined, passed: float) -> None:
        """Compare the step from the picture before, as both are aligned, with the robot's word; remember the way in."""
        before, good = self._aligned, self.settings.challenger.challenge_below
        if before is not None and min(before.score, refined.score) >= good:
            mm, rad = self.settings.smoothing.noise(min(before.score, refined.score))
            self._robot.learn(inverse(before.T_kidney_camera) @ refined.T_kidney_camera, mm, rad, passed)
        if refined.score >= good:
            self._robot.mark(refined.T_kidney_camera)

    def _follow(
        self,
        features: Features,
        t_s: float,
        sensor: SensorReading | None,
        start: float,
        image: NDArray[np.uint8] | None,
    ) -> Tracked:
        """The answer to a picture that shows something."""
        passed = self.settings.own_kidney.frame_s if self._at_s is None else max(t_s - self._at_s, 1e-3)
        as_taken, features = features, self._pattern.removed(features)
        motion, carried = self.settings.motion, self._robot.carried
        since = None if self._before is None else Since.told(self._before, passed, motion, carried, self.lumen)
        prior = expected(since, sensor, self.settings.challenger, self.lumen, self._tether)
        way = None if carried is None else carried.T_before_now
        told = self._told_places(t_s)
        evidence, relocated, refined = None, None, self._gone_on(features, prior, way, t_s)
        if refined is None:
            self._found, fits = self._filter.update(self._reader.mapped(features), since, sensor)
            self._fit = float(fits[self._found.weight.argmax()])
            picture = Weighed(features, self._found, fits, prior, sensor, way, told)
            refined = self._pursuit.follow(picture, anew=self._state != TRACKING or not self._is_sure)
            refined, relocated = self._relocated(picture, as_taken, image, refined)
            plain = refined.score if features is as_taken else self._refiner.score(as_taken, refined)
            decoy = self._decoy.score(self._reader.mirrored(as_taken), t_s) if self._test.in_doubt else None
            evidence = self._judge(picture, refined.T_kidney_camera, plain, decoy, t_s, relocated is not None)
        found, fit = self._found, self._fit
        assert found is not None
        T_aligned = T = refined.T_kidney_camera
        if self._state == TRACKING:
            T = self._steady(T_aligned, refined.score, t_s, sensor, told)
        self._tether.see(T_aligned, refined.score, t_s, self._state == TRACKING and not self._course.coasts)
        self._learn(as_taken, refined, passed)
        self._remember(found, T if told else T_aligned, t_s)
        if self._state != TRACKING:
            if not self._tether.binds:
                self._course.reset()
            spent, places = time.perf_counter() - start, likeliest_places(found)
            return Tracked(self._state, None, -1, 0.0, fit, refined.score, spent, T_aligned, evidence, places=places)
        calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        self._sure, share = self._certainty(found, T, calyx, refined.score)
        if relocated is not None:
            self._sure = self._sure.relocated(T, relocated)
        if sensor is not None and sensor.camera_at(T) is not None:
            self._sure = self._sure.sensed(sensor.sigma_mm)
        confidence = share / (1 + np.exp(-self._test.trust))
        spent = time.perf_counter() - start
        state, places = self._state_at(self._sure), likeliest_places(found)
        return Tracked(state, T, calyx, confidence, fit, refined.score, spent, T_aligned, evidence, self._sure, places)

    def state_at(self, sure: TrackCertainty) -> str:
        """``tracking`` while a pose in this kidney is sure enough to be a place, else ``searching``."""
        return TRACKING if sure.region_mm <= self.settings.certainty.largest_mm else SEARCHING

    def _state_at(self, sure: TrackCertainty) -> str:
        """The same of the newest picture: a robot's word alone is no place while pictures contradict it."""
        return self.state_at(sure) if not self._course.coasts else SEARCHING

    def _certainty(self, found: Hypotheses, T: Array, calyx: int, score: float) -> tuple[TrackCertainty, float]:
        """How sure a pose (4, 4) and its calyx are, and the probability of the calyx among the hypotheses."""
        kidney = self.vid.kidney
        observed = observed_calyx(found.T_kidney_camera, kidney, self.lumen)
        evidence = track_evidence(found, observed, calyx, T, score, kidney.scale)
        probability = self.settings.certainty.set_probability
        errors = self._weights.position if self._robot.step is None else self._weights.position_told
        return track_certainty(evidence, self._weights, errors, probability, kidney.scale), float(evidence.share[calyx])

    def _relocated(
        self, picture: Weighed, as_taken: Features, image: NDArray[np.uint8] | None, refined: Refined
    ) -> tuple[Refined, Relocated | None]:
        """The pose aligned, or, where that is no place and the picture itself is surely found, one from there."""
        if self._relocalizer is None or not self._relocates or image is None:
            return refined, None
        if self._state == TRACKING:
            T = refined.T_kidney_camera
            calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
            sure, _ = self._certainty(picture.found, T, calyx, refined.score)
            if sure.region_mm <= self.settings.relocalization.above_mm:
                return refined, None
        self._relocalizer.look_through(self._reader.scene)
        found = self._relocalizer.locate(image, as_taken)
        if found is None or not self._tether.reaches(found.T_kidney_camera):
            return refined, None
        self._course.reset()
        return self._pursuit.restart(picture, found.T_kidney_camera), found

    def _remember(self, found: Hypotheses, T: Array, t_s: float) -> None:
        """Keep the hypotheses, and the track's pose as one of them."""
        own = self.settings.filter.incumbent_share * self._pursuit.trusted
        self._before = with_incumbent(found, T, own, self.lumen)
        self._at_s, self._seen_s = t_s, t_s

    def _gone_on(self, features: Features, prior: Prior, way: Array | None, t_s: float) -> Refined | None:
        """The pose of a settled track, aligned alone, with the hypotheses carried along; None where it is time, or
        necessary, to weigh the picture against all views."""
        due = self._looked_s is None or t_s - self._looked_s >= self._filter.settings.every_s - _SAME_TIME_S
        sure = self._sure is not None and self._state_at(self._sure) == TRACKING
        if due or not sure or self._state != TRACKING or self._aligned is None or self._found is None:
            return None
        before = self._aligned.T_kidney_camera
        refined = self._pursuit.go_on(features, prior, way)
        if refined is not None:
            self._found = self._found.carried(inverse(before) @ refined.T_kidney_camera, self.lumen)
        return refined

    def _judge(
        self, picture: Weighed, T: Array, score: float, decoy: float | None, t_s: float, relocated: bool
    ) -> KidneyEvidence:
        """Settle the state after a picture aligned at a pose (4, 4); scores are for the picture as it was taken."""
        seconds = self.settings.own_kidney.frame_s if self._looked_s is None else max(t_s - self._looked_s, 1e-3)
        self._looked_s = t_s
        off = None if picture.sensor is None else float(picture.sensor.off(T[None])[0])
        evidence = KidneyEvidence(score, float(picture.fits.max()), decoy, off, relocated)
        self._test.add(evidence, seconds)
        if self._test.verdict is not None:
            self._state = TRACKING if self._test.verdict else LOST
        self._is_sure = self._state == TRACKING and (self._is_sure or not self._test.in_doubt)
        return evidence

    def _steady(
        self, T: Array, score: float, t_s: float, sensor: SensorReading | None, told: tuple[Array, ...]
    ) -> Array:
        """The pose smoothed, see `Course.follow`; what spoke for a place does not speak for the one leapt to."""
        T, leapt = self._course.follow(T, score, t_s, sensor, told, self._tether.reaches(T))
        if leapt:
            self._test.leapt()
            self._state = SEARCHING
        return T

    def _bridge(self, t_s: float, start: float) -> Tracked:
        """The answer to a picture that shows nothing: where motion leads, for a while."""
        blind = t_s - self._seen_s > self.settings.filter.bridge_s and self._robot.carried is None
        if self._state == TRACKING and blind:
            self._state = SEARCHING
            self._course.reset()
        T = self._course.predict(t_s, self._robot.step) if self._state == TRACKING else None
        if T is None:
            return Tracked(self._state, None, -1, 0.0, np.nan, np.nan, time.perf_counter() - start)
        calyx = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        away = t_s - self._seen_s
        share = 1.0 if self._sure is None else float(self._sure.evidence.share[calyx])
        confidence = 0.5 ** (away / self.settings.filter.bridge_s) * share / (1 + np.exp(-self._test.trust))
        mm, deg = self.settings.filter.drift_mm_s * away, self.settings.motion.turn_deg_s * away
        carried = self._robot.carried
        if carried is not None:
            mm, deg = carried.sd_mm, float(np.degrees(carried.sd_rad))
        sure = None if self._sure is None else self._sure.later(mm, deg).of(calyx)
        state = TRACKING if sure is None else self._state_at(sure)
        spent = time.perf_counter() - start
        return Tracked(state, T, calyx, confidence, np.nan, np.nan, spent, certainty=sure)
