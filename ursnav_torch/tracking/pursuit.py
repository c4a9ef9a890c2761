"""The track at hand: one refined pose taken on from picture to picture, beside a challenger that may take over."""

from dataclasses import dataclass
from itertools import cycle

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import Expectation, Refined, Refiner
from ursnav_torch.alignment.light import LampState
from ursnav_torch.alignment.refine import Prior
from ursnav_torch.features import Features
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.tracking.filter import place
from ursnav_torch.tracking.motion import Hypotheses, Since
from ursnav_torch.tracking.robot.tether import Tether
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, FilterSettings

Array = NDArray[np.float64]
#: Share of a new picture in what a track scores of late.
_NEWS = 0.1
#: Alignments that end this near to each other are one; mm at the kidney's scale 1, degrees.
_SAME_MM, _SAME_DEG = 0.3, 2.0


@dataclass(frozen=True, slots=True)
class Weighed:
    """A picture, and what the filter makes of it.

    Attributes:
        features: of the picture.
        found: the hypotheses, and ``fits`` (M,) how well each of them fits.
        prior: what motion says of poses, in units of the alignment's score.
        sensor: the EM reading, if there is one.
        carried: how the camera was carried since the picture before (4, 4), where a robot told.
        told: poses (4, 4) where a robot's word puts the camera: as far on as it was carried, and along the shaft's way.
    """

    features: Features
    found: Hypotheses
    fits: Array
    prior: Prior
    sensor: SensorReading | None
    carried: Array | None = None
    told: tuple[Array, ...] = ()


@dataclass(frozen=True, slots=True)
class _Lead:
    """A track: its refined pose in the last picture and in the one before."""

    refined: Refined
    before: Refined | None = None

    def ahead(self, carried: Array | None) -> list[Array]:
        """Where the next pose may be: where the robot carried it, else as far on as the last step led; or here."""
        here = self.refined.T_kidney_camera
        if carried is None:
            if self.before is None:
                return [here]
            carried = inverse(self.before.T_kidney_camera) @ here
        on = here @ carried
        R = Rotation.from_matrix(on[:3, :3]).as_matrix()  # else rounding errors double from picture to picture
        return [transform_from(R, on[:3, 3]), here]


def expected(
    since: Since | None,
    sensor: SensorReading | None,
    settings: ChallengerSettings,
    lumen: LumenDistance,
    tether: Tether | None = None,
) -> Prior:
    """What motion since the picture before, sensor and robot say of poses, in units of the alignment's score."""

    def prior(T: Array) -> Array:
        log = np.zeros(len(T))
        if since is not None:
            log = since.log_probability(T, lumen.to_calyces(T[:, :3, 3]))
            log = np.maximum(log - log.max(), -settings.score_step / settings.prior_weight)
        if sensor is not None:
            log = log + sensor.log_probability(T)
        return settings.prior_weight * log - (0.0 if tether is None else tether.against(T))

    return prior


class Pursuit:
    """Follows one pose from picture to picture, and knows when another has been the better one for a while.

    Args:
        refiner: aligns poses with pictures.
        settings, same: see `ChallengerSettings`; ``same`` says which poses are one place. Lengths in mm of this kidney.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.

    Attributes:
        starts: poses that the track is tried to go on from.
        catches: poses that are tried after a slip.
    """

    def __init__(
        self, refiner: Refiner, settings: ChallengerSettings, same: FilterSettings, unit_mm: float = 1.0
    ) -> None:
        self._refiner, self._settings, self._same, self._unit_mm = refiner, settings, same, unit_mm
        self.starts, self.catches = settings.starts, settings.catches
        self.reset()

    def reset(self) -> None:
        """Forget the track, and the scope's light."""
        self._light = LampState()
        self._incumbent: _Lead | None = None
        self._challenger: _Lead | None = None
        self._good: Array | None = None  # last pose that was not badly aligned
        self._evidence, self._deeper = 0.0, 1.0
        self._held: Array | None = None  # pose before the track slipped
        self._usual, self._slipped = 0.0, 0  # score of late; pictures of the slip so far
        self._missed: tuple[list[Array], Refined] | None = None  # starts of the same picture that were not enough
        self._borne_out = False  # whether the filter, when it last looked, found the track's place the most probable
        self._rng = np.random.default_rng(0)  # the same pictures give the same answers

    @property
    def trusted(self) -> float:
        """1 while nothing speaks for a challenger, 0 when it is about to take over."""
        return 1 - min(self._evidence / self._settings.takeover_evidence, 1.0)

    @property
    def settled(self) -> bool:
        """Whether nothing speaks against the track: it was borne out, does not slip, and has no challenger."""
        return self._borne_out and not self._slipped and self._challenger is None and self._evidence == 0

    def go_on(self, features: Features, prior: Prior, carried: Array | None = None) -> Refined | None:
        """The pose of a settled track in the next picture, from where motion leads alone.

        Args:
            features: of the picture.
            prior: see `Weighed`.
            carried: (4, 4), see `Weighed`.

        Returns:
            None where the track is not settled or the pose is aligned worse than of late: `follow` has to look.
        """
        s, own = self._settings, self._incumbent
        if own is None or not self.settled:
            return None
        starts = self._on(own, carried)[: self.starts]
        found = self._aligned(features, starts, prior)
        if found.score < max(self._usual - s.usual_drop, s.enough_above):
            self._missed = starts, found
            return None
        self._incumbent = _Lead(found, own.refined)
        self._learn(found)
        return found

    def follow(self, picture: Weighed, anew: bool) -> Refined:
        """The track's pose in the next picture.

        Where the filter holds another place more probable, or the track is aligned badly and another place fits, that
        is followed beside it, and becomes the track once it has been the better aligned for a while.

        Args:
            picture: the picture.
            anew: look for the track among all hypotheses.
        """
        s, T, features = self._settings, place(picture.found, self._same), picture.features
        if anew or self._incumbent is None or self._incumbent.refined.score < s.reacquire_below:
            self._incumbent = _Lead(self._aligned(features, self._anywhere(picture, T), picture.prior))
            self._challenger, self._evidence, self._slipped, self._borne_out = None, 0.0, 0, False
            self._usual = self._incumbent.refined.score
        else:
            agrees, before = self._near(T, self._incumbent.refined.T_kidney_camera), self._incumbent.refined
            self._incumbent = self._caught(picture, _Lead(self._taken_on(picture, self._incumbent, T), before))
            here = self._incumbent.refined
            elsewhere: list[Array] = []
            self._borne_out = agrees or self._near(T, here.T_kidney_camera)
            if not self._borne_out:
                elsewhere = [T]
            elif here.score < s.challenge_below:
                elsewhere = self._apart([here.T_kidney_camera], picture.found, picture.fits, 2)[1:]
            self._incumbent = self._better(picture, self._incumbent, elsewhere)
        self._learn(self._incumbent.refined)
        self._missed = None
        return self._incumbent.refined

    def restart(self, picture: Weighed, T_kidney_camera: Array) -> Refined:
        """Go on from a pose (4, 4) that a picture was found at by itself, aligned with it."""
        found = self._aligned(picture.features, [T_kidney_camera], picture.prior)
        self._incumbent, self._challenger, self._good = _Lead(found), None, found.T_kidney_camera
        self._evidence, self._slipped, self._usual = 0.0, 0, found.score
        self._borne_out = False
        return found

    def _taken_on(self, picture: Weighed, own: _Lead, T: Array) -> Refined:
        """The track aligned from where it may go on; what `go_on` has aligned of the same picture is not done again."""
        starts, found = self._missed or (self._on(own, picture.carried), None)
        around = self._around([*starts, *picture.told], T, picture)[: self.starts + len(picture.told)]
        if found is None:
            return self._aligned(picture.features, around, picture.prior)
        if len(around) == len(starts):
            return found
        other = self._aligned(picture.features, around[len(starts) :], picture.prior)
        return other if other.score > found.score else found

    def _learn(self, refined: Refined) -> None:
        """Take in how the track is aligned."""
        self._usual += _NEWS * (refined.score - self._usual)
        self._light.learn(refined.light, refined.score)
        if refined.score >= self._settings.reacquire_below:
            self._good = refined.T_kidney_camera

    def _caught(self, picture: Weighed, own: _Lead) -> _Lead:
        """The track, or, where it has slipped, a better aligned pose near the one that it slipped from."""
        s, ahead = self._settings, own if own.before is None else _Lead(own.before)
        if own.refined.score >= self._usual - s.slip_drop or not self.catches:
            self._slipped = 0
            return own
        self._held = ahead.ahead(None)[0] if not self._slipped or self._held is None else self._held
        if picture.carried is not None:
            self._held = self._held @ picture.carried
        self._slipped += 1
        sd = np.sqrt(self._slipped) * np.repeat([s.catch_mm, np.radians(s.catch_deg)], 3)
        steps = self._rng.normal(size=(self.catches, 6)) * sd
        turns = Rotation.from_rotvec(steps[:, 3:]).as_matrix()
        around = cycle([self._held, *picture.told[1:2]])
        starts = [at @ transform_from(R, way) for at, R, way in zip(around, turns, steps[:, :3], strict=False)]
        found = self._aligned(picture.features, starts, picture.prior)
        return _Lead(found, own.before) if found.score > own.refined.score + s.score_step / 2 else own

    def _better(self, picture: Weighed, own: _Lead, elsewhere: list[Array]) -> _Lead:
        """The incumbent, or the challenger once that has been the better one; other places may become challengers."""
        s, before, sensor = self._settings, self._challenger, picture.sensor
        tried = elsewhere if before is None else [*before.ahead(picture.carried), *elsewhere]
        if not tried:
            self._evidence = max(self._evidence - 1.0, 0.0)
            return own
        found = self._aligned(picture.features, tried)
        if self._near(found.T_kidney_camera, own.refined.T_kidney_camera):
            self._challenger, self._evidence = None, max(self._evidence - 1.0, 0.0)
            return own
        same = before is not None and self._near(found.T_kidney_camera, before.refined.T_kidney_camera)
        challenger = _Lead(found, before.refined if before is not None and same else None)
        gain = (found.score - own.refined.score) / s.score_step
        if sensor is not None:
            off_own, off_challenger = (sensor.off(lead.refined.T_kidney_camera[None])[0] for lead in (own, challenger))
            gain += float(np.clip(off_own - off_challenger, -1.0, 1.0))
        self._evidence = max((self._evidence if same else 0.0) + float(np.clip(gain, -1.0, s.max_step)), 0.0)
        if self._evidence >= s.takeover_evidence:
            self._challenger, self._evidence = None, 0.0
            return challenger
        self._challenger = None if gain < 0 and self._evidence == 0.0 else challenger
        return own

    def _anywhere(self, picture: Weighed, T: Array) -> list[Array]:
        """What is known of the track, and the hypotheses that fit best or are most probable."""
        known = list(picture.told)
        known += [] if self._incumbent is None else [self._incumbent.refined.T_kidney_camera]
        known += [] if self._good is None else [self._good]
        known += [] if self._challenger is None else [self._challenger.refined.T_kidney_camera]
        fitting = self._apart([*known, T], picture.found, picture.fits, self._settings.starts)
        return self._apart(fitting, picture.found, picture.found.weight, self._settings.starts + 3)

    def _apart(self, tried: list[Array], found: Hypotheses, worth: Array, count: int) -> list[Array]:
        """The poses given and the hypotheses of most worth (M,) that lie apart from them and each other, ``count``."""
        tried = list(tried)
        for pose in found.T_kidney_camera[np.argsort(-worth)]:
            if len(tried) < count and not any(self._near(pose, t) for t in tried):
                tried.append(pose)
        return tried

    def _on(self, own: _Lead, carried: Array | None) -> list[Array]:
        """Where a track may go on: ahead, and a step deeper or less deep in turn.

        Depth is what alignment tells least, and where it slips.
        """
        ahead = own.ahead(carried)
        self._deeper = -self._deeper
        slid = ahead[-1].copy()
        slid[:3, 3] += self._deeper * self._settings.depth_step_mm * slid[:3, 2]
        return [ahead[0], slid, *ahead[1:]]

    def _around(self, starts: list[Array], T: Array, picture: Weighed) -> list[Array]:
        """Some starts, and places among the hypotheses near the first of them."""
        s, near_mm, found = self._settings, self._same.same_place_mm, picture.found
        tried = list(starts)
        order = np.argsort(-found.weight)[: self._same.best_fitting]
        for pose in [T, *found.T_kidney_camera[order]]:
            apart = [np.linalg.norm(pose[:3, 3] - t[:3, 3]) for t in tried]
            if min(apart) > s.depth_step_mm / 2 and apart[0] < 2 * near_mm and len(tried) < s.starts:
                tried.append(pose)
        return tried

    def _aligned(self, features: Features, candidates: list[Array], prior: Prior | None = None) -> Refined:
        light, known, near = self._light.value, self._light.known, (_SAME_MM * self._unit_mm, _SAME_DEG)
        return self._refiner.refine(features, candidates, Expectation(light, known, prior, *near))

    def _near(self, T_a: Array, T_b: Array) -> bool:
        """Whether two poses are one place."""
        return bool(are_near(T_a[None], T_b, self._same.same_place_mm, self._same.same_place_deg)[0])
