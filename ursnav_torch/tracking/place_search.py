"""Where in the VID a picture fits, given what was known before: every view weighed, the best tried at small tilts."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import Features, polar_grid, polar_maps
from ursnav_torch.geometry import transform_from
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.search.pose_mean import NEAR_DEG, NEAR_MM, mean_pose
from ursnav_torch.search.scan import RollScan, tilts
from ursnav_torch.tracking.motion import Hypotheses, MotionSettings, transition
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
#: Log-probability density at which a reading that fits nowhere stops counting.
_SENSOR_WRONG = -8.0


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """How pictures are weighed over time.

    Attributes:
        relief_weight, direction_weight: of the scan's channels, see `LocalizationSettings`.
        fit_width: a fit better by this is e times as probable.
        tilt_step_deg, tilt_rounds: tilts tried for the best hypotheses.
        hypotheses: poses kept from picture to picture.
        newcomers: of these, poses that fit best wherever they are.
        near_mm, near_deg: hypotheses within this of the best are one place; their mean is the pose.
        own_share: probability of the track's own pose beside the views'.
        tries: poses that the track is tried to go on from.
        slide_mm: step in depth that is tried; other poses tried are half as far apart at least.
        shaky: after an alignment that scores less, the track is looked for anew among all hypotheses.
        unsure: while alignments score less, a place that fits well is aligned beside the track.
        better_by: another place whose alignment scores better by this is preferred a full step.
        motion_weight: score an alignment is held back by for every e-fold that motion makes its pose less probable,
            up to ``better_by``.
        most_gain: a single picture counts for no more steps than this.
        convinced: so many steps, and it becomes the track.
        bridge_s: pictures that show nothing are bridged for this long.
        usual_s: time between pictures that the next numbers are stated for.
        own_kidney: constant, and weights of an `Evidence`'s score, lead and fit, in the log-odds that a picture shows
            the VID's kidney and not another: logistic regression over flights through eight phantoms, each in its own
            and in others' VIDs, plus 1 for a right VID being likelier than a wrong one (`benchmarks.own_kidney`).
        own_sensor: a sensor's reading that the pose meets within so many standard deviations speaks for this kidney;
            the alignment's own noise is among them.
        most: a single picture speaks against this kidney no more than this, and for it no more than ``most_gain``.
        believe, give_up: the sum of the log-odds from which on a track is believed, and below minus which it is given
            up.
        debt, credit: the sum stays between minus the one and the other: a long good track outlasts a bad stretch.
    """

    relief_weight: float = 1.0
    direction_weight: float = 2.0
    fit_width: float = 0.15
    tilt_step_deg: float = 5.0
    tilt_rounds: int = 2
    hypotheses: int = 72
    newcomers: int = 36
    near_mm: float = NEAR_MM
    near_deg: float = NEAR_DEG
    own_share: float = 0.5
    tries: int = 5
    slide_mm: float = 2.0
    shaky: float = 0.35
    unsure: float = 0.65
    better_by: float = 0.1
    motion_weight: float = 0.01
    most_gain: float = 2.0
    convinced: float = 3.0
    bridge_s: float = 1.0
    usual_s: float = 0.1
    own_kidney: tuple[float, float, float, float] = (-4.2, 15.8, 4.9, -3.1)
    own_sensor: float = 3.0
    most: float = 1.0
    believe: float = 3.0
    give_up: float = 4.0
    debt: float = 6.0
    credit: float = 20.0

    def __post_init__(self) -> None:
        if not 0 < self.newcomers < self.hypotheses or self.fit_width <= 0:
            raise InputError(
                "Tracking needs 0 < newcomers < hypotheses and fit_width > 0, got "
                f"{self.newcomers}, {self.hypotheses} and {self.fit_width}."
            )


@dataclass(frozen=True, slots=True)
class SensorReading:
    """Where the EM sensor is, in the kidney frame.

    Attributes:
        position_mm: (3,) kidney frame.
        offset_camera_mm: (3,) the sensor's place in the camera frame.
        sigma_mm: standard deviation of the position along each axis, registration included.
    """

    position_mm: Array
    offset_camera_mm: Array
    sigma_mm: float

    def off(self, T_kidney_camera: Array, coarse_mm: float = 0.0) -> Array:
        """(N,) standard deviations by which poses (N, 4, 4), themselves ``coarse_mm`` coarse, miss the reading."""
        at = T_kidney_camera[:, :3, :3] @ self.offset_camera_mm + T_kidney_camera[:, :3, 3]
        return np.linalg.norm(at - self.position_mm, axis=1) / np.hypot(self.sigma_mm, coarse_mm)

    def log_probability(self, T_kidney_camera: Array, coarse_mm: float = 0.0) -> Array:
        """Of poses (N, 4, 4), up to a constant; a reading that fits nowhere stops counting: the sensor may be wrong."""
        return np.logaddexp(-0.5 * self.off(T_kidney_camera, coarse_mm) ** 2, _SENSOR_WRONG)

    def camera_at(self, T_kidney_camera: Array) -> Array | None:
        """Where (3,) the camera is if it looks as in a pose (4, 4); None where that contradicts the pose."""
        T = T_kidney_camera
        at = self.position_mm - T[:3, :3] @ self.offset_camera_mm
        return at if np.linalg.norm(at - T[:3, 3]) <= 4 * self.sigma_mm else None


class PlaceSearch:
    """The views of a VID, ready to be weighed against one picture after the other.

    Args:
        vid, lumen: the views, and distances in their kidney.
        settings, motion: how to weigh.
        working_camera: the lens in which features give their fields.
    """

    def __init__(
        self, vid: Vid, lumen: LumenDistance, settings: TrackSettings, motion: MotionSettings, working_camera: Camera
    ) -> None:
        self.settings, self.motion, self._unit = settings, motion, vid.kidney.scale
        self._T, self._to_tips = vid.T_kidney_camera, lumen.to_calyces(vid.T_kidney_camera[:, :3, 3])
        channels = vid.features.maps.shape[1]
        weight = torch.full((channels,), settings.direction_weight * 2 / max(channels - 1, 1))
        weight[0] = settings.relief_weight
        self._scan = RollScan(vid.features.maps, weight)
        self._tilts = tilts(settings.tilt_step_deg, settings.tilt_rounds)
        self._grids = polar_grid(working_camera, self._tilts)

    def weigh(
        self, features: Features, before: Hypotheses | None, seconds: float, sensor: SensorReading | None
    ) -> tuple[Hypotheses, Array]:
        """The hypotheses after a picture, some seconds after those before, and how well each of them fits (M,)."""
        s = self.settings
        straight = self._scan.scan(features.maps[None])
        T = self._T @ _rolled(straight.roll, np.eye(3))
        score = straight.score.numpy().astype(float)
        views = self._worth_trying(self._prior(T, self._to_tips, before, seconds, sensor) + score / s.fit_width, score)
        tilted = self._scan.scan(polar_maps(features.fields, self._grids), torch.from_numpy(views))
        T = self._T[views] @ _rolled(tilted.roll, np.swapaxes(self._tilts[tilted.tilt.numpy()], 1, 2))
        to_tips, score = self._to_tips[views], tilted.score.numpy().astype(float)
        log = self._prior(T, to_tips, before, seconds, sensor) + score / s.fit_width
        weight = np.exp(log - log.max())
        return Hypotheses(T, to_tips, weight / weight.sum()), score

    def _worth_trying(self, log: Array, score: Array) -> NDArray[np.int64]:
        """The most probable views, and those that fit best wherever they are."""
        s = self.settings
        probable = np.argsort(-log)[: s.hypotheses - s.newcomers]
        return np.union1d(probable, np.argsort(-score)[: s.newcomers])

    def _prior(
        self, T: Array, to_tips: Array, before: Hypotheses | None, seconds: float, sensor: SensorReading | None
    ) -> Array:
        """Log-probability (N,) of poses before the picture is looked at."""
        log = np.zeros(len(T))
        if before is not None:
            log = transition(before, T, to_tips, seconds, self.motion, self._unit)
        if sensor is not None:
            log = log + sensor.log_probability(T, self.motion.spacing_mm * self._unit)
        return log


def place(hypotheses: Hypotheses, settings: TrackSettings, unit: float) -> Array:
    """The mean pose (4, 4) of the hypotheses near the best."""
    weight = hypotheses.weight
    best = int(weight.argmax())
    return mean_pose(hypotheses.T_kidney_camera, weight, best, settings.near_mm * unit, settings.near_deg)[0]


def _rolled(roll: torch.Tensor, R: Array) -> Array:
    """Transforms (N, 4, 4) that turn by R (3, 3) or (N, 3, 3), then by rolls (N,) about the optical axis."""
    turn = Rotation.from_rotvec(roll.numpy()[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    return transform_from(turn @ R, np.zeros(3))
