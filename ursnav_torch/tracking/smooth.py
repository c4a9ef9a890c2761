"""Smoothing a track lightly, by the scope's motion alone: a Kalman filter at constant velocity, causal.

Of a recording, a whole stretch at once from the pictures before and those after: position and velocity by Rauch, Tung
and Striebel (AIAA Journal 3:1445, 1965), rotation by the same gains on the turn between neighbors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from
from ursnav_torch.tracking.robot.odometry import Carried

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SmoothSettings:
    """How much is believed to be noise; lengths are mm at the kidney's scale 1, see `scaled`.

    Attributes:
        position_sd_mm, turn_sd_deg: standard deviation of a well aligned pose.
        good_score: alignment score of such a pose.
        noise_growth: e-folds by which the deviation grows as the score falls short of ``good_score`` by 1.
        acceleration_sd_mm_s2: standard deviation of the scope's acceleration.
        turn_rate_sd_deg_s: standard deviation of its angular rate.
        fade_s: a scope that nothing is seen of is believed to come to rest within this time.
        first_speed_sd_mm_s: how fast it may be when it is first seen.
    """

    position_sd_mm: float = 0.35
    turn_sd_deg: float = 2.0
    good_score: float = 0.75
    noise_growth: float = 7.0
    acceleration_sd_mm_s2: float = 25.0
    turn_rate_sd_deg_s: float = 35.0
    fade_s: float = 0.3
    first_speed_sd_mm_s: float = 5.0

    def __post_init__(self) -> None:
        deviations = (self.position_sd_mm, self.turn_sd_deg, self.acceleration_sd_mm_s2, self.turn_rate_sd_deg_s)
        if min(*deviations, self.fade_s, self.first_speed_sd_mm_s) <= 0:
            raise InputError(f"Smoothing needs standard deviations and times above 0, got {self}.")

    def noise(self, score: float) -> tuple[float, float]:
        """Standard deviations, in mm and radians, of a pose aligned with a score."""
        worse = float(np.exp(self.noise_growth * max(self.good_score - score, 0.0)))
        return self.position_sd_mm * worse, float(np.radians(self.turn_sd_deg)) * worse

    def motion(self, seconds: float) -> tuple[Array, Array, float]:
        """What time does to position and velocity (2, 2), the covariance (2, 2) it adds, and the turn's variance."""
        dt, fade = seconds, np.exp(-seconds / self.fade_s)
        F = np.array([[1.0, self.fade_s * (1 - fade)], [0.0, fade]])
        pushed = self.acceleration_sd_mm_s2**2 * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
        return F, pushed, float((np.radians(self.turn_rate_sd_deg_s) * dt) ** 2)


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of a moving camera at one time.

    Attributes:
        state: (2, 3) position and velocity.
        covariance: (2, 2) of the two, the same along each axis.
        R: (3, 3) rotation.
        turn_variance: of the rotation, about each axis, square radians.
        at_s: the time.
    """

    state: Array
    covariance: Array
    R: Array
    turn_variance: float
    at_s: float

    def pose(self) -> Array:
        """(4, 4)."""
        return transform_from(self.R, self.state[0])


class PoseFilter:
    """Position and velocity by a Kalman filter, one for all axes; rotation by the gain that its own noise gives.

    Attributes:
        belief: what is believed now, None before the first pose.
    """

    def __init__(self, settings: SmoothSettings | None = None) -> None:
        self.settings = settings or SmoothSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the track."""
        self.belief: Belief | None = None

    def predict(self, t_s: float, carried: Carried | None = None) -> Array | None:
        """Pose (4, 4) at a later time, as far as motion tells, or a robot of it; None before the first pose."""
        b = self.belief
        if b is None:
            return None
        if carried is not None:
            step, dt = carried.T_before_now, carried.seconds
            way = b.R @ step[:3, 3]
            P = np.diag([b.covariance[0, 0] + carried.sd_mm**2, (carried.sd_mm / dt) ** 2])
            R = b.R @ step[:3, :3]
            self.belief = Belief(np.stack([b.state[0] + way, way / dt]), P, R, b.turn_variance + carried.sd_rad**2, t_s)
            return self.belief.pose()
        F, pushed, turned = self.settings.motion(max(t_s - b.at_s, 0.0))
        self.belief = Belief(F @ b.state, F @ b.covariance @ F.T + pushed, b.R, b.turn_variance + turned, t_s)
        return self.belief.pose()

    def update(self, T_kidney_camera: Array, t_s: float, score: float) -> Array:
        """The smoothed pose (4, 4) after a pose measured at ``t_s`` with an alignment score."""
        sigma, turn = self.settings.noise(score)
        if self.predict(t_s) is None:
            state = np.stack([T_kidney_camera[:3, 3], np.zeros(3)])
            covariance = np.diag([sigma, self.settings.first_speed_sd_mm_s]) ** 2
            self.belief = Belief(state, covariance, T_kidney_camera[:3, :3].copy(), turn**2, t_s)
        else:
            self.measure(T_kidney_camera[:3, 3], sigma)
            b = self.belief
            assert b is not None
            gain = b.turn_variance / (b.turn_variance + turn**2)
            turned = Rotation.from_matrix(b.R.T @ T_kidney_camera[:3, :3]).as_rotvec()
            R = b.R @ Rotation.from_rotvec(gain * turned).as_matrix()
            self.belief = replace(b, R=R, turn_variance=(1 - gain) * b.turn_variance)
        return self.pose()

    def measure(self, position_mm: Array, sigma_mm: float) -> None:
        """Take in a position (3,) at the time of the last prediction or update."""
        b = self.belief
        assert b is not None
        gain = b.covariance[:, 0] / (b.covariance[0, 0] + sigma_mm**2)
        state = b.state + gain[:, None] * (position_mm - b.state[0])
        self.belief = replace(b, state=state, covariance=b.covariance - np.outer(gain, b.covariance[0]))

    def pose(self) -> Array:
        """(4, 4) the present pose."""
        assert self.belief is not None
        return self.belief.pose()


@dataclass(frozen=True, slots=True)
class Measured:
    """A pose (4, 4) as it was aligned with a picture, the alignment's score, and positions (3,) known besides.

    Attributes:
        T_kidney_camera: (4, 4).
        score: see `Refined`.
        positions: (position_mm, standard deviation) of other instruments.
    """

    T_kidney_camera: Array
    score: float
    positions: tuple[tuple[Array, float], ...] = ()


def smooth_stretch(measured: Sequence[Measured | None], t_s: Sequence[float], settings: SmoothSettings) -> list[Array]:
    """Poses (4, 4) of one unbroken track.

    Args:
        measured: one a time, None where nothing was seen; the first is something.
        t_s: rising times in seconds.
        settings: motion and noise, lengths in mm of this kidney.
    """
    ahead, expected = PoseFilter(settings), list[Belief | None]()
    believed: list[Belief] = []
    for what, at_s in zip(measured, t_s, strict=True):
        ahead.predict(at_s)
        expected.append(ahead.belief)
        if what is not None:
            ahead.update(what.T_kidney_camera, at_s, what.score)
            for position_mm, sigma_mm in what.positions:
                ahead.measure(position_mm, sigma_mm)
        assert ahead.belief is not None, "the first of a stretch must be measured"
        believed.append(ahead.belief)
    state, R = believed[-1].state, believed[-1].R
    poses = [transform_from(R, state[0])]
    for here, after in zip(believed[-2::-1], expected[:0:-1], strict=True):
        assert after is not None
        F, _, _ = settings.motion(after.at_s - here.at_s)
        gain = here.covariance @ F.T @ np.linalg.inv(after.covariance)
        state = here.state + gain @ (state - after.state)
        turned = Rotation.from_matrix(here.R.T @ R).as_rotvec()
        R = here.R @ Rotation.from_rotvec(here.turn_variance / after.turn_variance * turned).as_matrix()
        poses.append(transform_from(R, state[0]))
    return poses[::-1]
