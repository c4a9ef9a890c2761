"""What is believed of the camera: a Gaussian over its pose and its motion (error-state Kalman filter).

The error lives in the camera's own frame (right perturbation, Sola et al., arXiv:1812.01537), so that "along the
axis" and "across it" keep their meaning while the scope turns: what a straight tube leaves open is depth, and the
covariance says so. It grows without evidence and shrinks with it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import inverse, transform_from

Array = NDArray[np.float64]

#: A normal distribution in space holds 90 % within this many standard deviations per axis (chi, 3 degrees of freedom).
REGION_90 = 2.5003
#: Mahalanobis distance, squared, that one true measurement in a hundred exceeds (chi-squared, 6 degrees of freedom).
_USUAL = 16.81


@dataclass(frozen=True, slots=True)
class BeliefSettings:
    """Noise of motion and of alignments; lengths are mm at the kidney's scale 1, see `scaled`.

    Attributes:
        position_mm, turn_deg: standard deviation that every aligned pose has: the kidney is not what it was when it
            was scanned.
        reach_mm: an alignment that is told nothing ends within this of where it began.
        correlated_px: so many pixels err together that alignment counts as single ones.
        push_mm_s: standard deviation of what a second adds to the velocity.
        swing_deg_s: the same of the turning.
        fade_s: a scope that nothing is seen of comes to rest within this time.
        speed_mm_s, turning_deg_s: standard deviation of the first velocity.
    """

    position_mm: float = 0.3
    turn_deg: float = 1.5
    reach_mm: float = 5.0
    correlated_px: float = 40.0
    push_mm_s: float = 16.0
    swing_deg_s: float = 60.0
    fade_s: float = 0.6
    speed_mm_s: float = 6.0
    turning_deg_s: float = 25.0

    def __post_init__(self) -> None:
        if min(self.position_mm, self.turn_deg, self.correlated_px, self.push_mm_s, self.swing_deg_s, self.fade_s) <= 0:
            raise InputError(f"A belief needs standard deviations and times above 0, got {self}.")

    def measured(self, information: Array, score: float) -> Array:
        """Covariance (6, 6) of an aligned pose, camera frame, position before turn.

        Args:
            information: (6, 6) of the alignment, J^T W J of standardized fields.
            score: of the alignment; what fields do not share is noise.
        """
        noise = self.correlated_px * max(1 - score**2, 0.02)
        floor = np.repeat([self.position_mm, np.radians(self.turn_deg)], 3) ** 2
        prior = np.diag(np.repeat([self.reach_mm, np.radians(40.0)], 3) ** -2.0)  # alignment starts from somewhere near
        return np.asarray(np.linalg.inv(information / noise + prior) + np.diag(floor), float)


@dataclass(frozen=True, slots=True)
class Motion:
    """What instruments say of the motion between two times: a twist (6,), mm/s and rad/s, and its covariance (6, 6)."""

    twist: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class PoseBelief:
    """A Gaussian over the camera's pose and motion at one time.

    Attributes:
        T_kidney_camera: (4, 4) mean.
        twist: (6,) mean velocity, mm/s, and turning, rad/s, camera frame.
        covariance: (12, 12) of position, turn, velocity and turning, camera frame.
        at_s: the time.
    """

    T_kidney_camera: Array
    twist: Array
    covariance: Array
    at_s: float

    @classmethod
    def first(cls, T: Array, covariance: Array, at_s: float, settings: BeliefSettings) -> "PoseBelief":
        """At an aligned pose (4, 4) with a covariance (6, 6), moving nobody knows how."""
        P = np.zeros((12, 12))
        P[:6, :6] = covariance
        speeds = np.repeat([settings.speed_mm_s, np.radians(settings.turning_deg_s)], 3)
        P[6:, 6:] = np.diag(speeds**2)
        return cls(T, np.zeros(6), P, at_s)

    @property
    def position_sd_mm(self) -> float:
        """Standard deviation of the position, an axis; 2.5 of it around the mean is the 90 % region."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3))

    @property
    def direction_sd_deg(self) -> float:
        """Standard deviation of the viewing direction, either way aside."""
        return float(np.degrees(np.sqrt((self.covariance[3, 3] + self.covariance[4, 4]) / 2)))

    def predicted(
        self, t_s: float, settings: BeliefSettings, motion: Motion | None = None, blind: bool = False
    ) -> "PoseBelief":
        """The belief at a later time.

        Args:
            t_s: the time.
            settings: noise.
            motion: what odometry or the pictures themselves say of the motion since.
            blind: nothing was seen of late: a scope is believed to come to rest.
        """
        dt = max(t_s - self.at_s, 0.0)
        if dt == 0:
            return self
        keep = float(np.exp(-dt / settings.fade_s)) if blind and motion is None else 1.0
        twist, P = keep * self.twist, self.covariance.copy()
        P[6:] *= keep
        P[:, 6:] *= keep
        push = np.repeat([settings.push_mm_s, np.radians(settings.swing_deg_s)], 3)
        P[6:, 6:] += np.diag(push**2 * dt)
        if motion is not None:
            K = np.linalg.solve(P[6:, 6:] + motion.covariance, P[6:]).T  # (12, 6)
            gain = K @ (motion.twist - twist)
            T_moved = moved(self.T_kidney_camera, gain[:6])
            twist, P = twist + gain[6:], _symmetric(P - K @ P[6:])
        else:
            T_moved = self.T_kidney_camera
        R_step = Rotation.from_rotvec(twist[3:] * dt).as_matrix()
        F = _step_jacobian(R_step, twist[:3] * dt, dt)
        T = T_moved @ transform_from(R_step, twist[:3] * dt)
        P = F @ P @ F.T
        P[:6, :6] += np.diag(push**2 * dt**3 / 3)  # noise of the velocity within the step
        return PoseBelief(_orthonormal(T), twist, _symmetric(P), t_s)

    def updated(self, T_measured: Array, covariance: Array) -> "tuple[PoseBelief, float]":
        """The belief after an aligned pose (4, 4) with a covariance (6, 6), and how far off that was.

        The distance is Mahalanobis', squared. A measurement that is farther off than one in a hundred counts as much
        less (heavy tails: its standard deviations grow by as much as the squared distance is too large).
        """
        off = _apart(self.T_kidney_camera, T_measured)
        P = self.covariance
        S = P[:6, :6] + covariance
        distance = float(off @ np.linalg.solve(S, off))
        if distance > _USUAL:
            S = P[:6, :6] + covariance * (distance / _USUAL) ** 2
        K = np.linalg.solve(S, P[:6]).T
        gain = K @ off
        T = moved(self.T_kidney_camera, gain[:6])
        found = PoseBelief(_orthonormal(T), self.twist + gain[6:], _symmetric(P - K @ P[:6]), self.at_s)
        return found, distance

    def measured_place(self, position_mm: Array, sigma_mm: float) -> "PoseBelief":
        """The belief after a position (3,), kidney frame, known within ``sigma_mm`` an axis."""
        P = self.covariance
        off = self.T_kidney_camera[:3, :3].T @ (position_mm - self.T_kidney_camera[:3, 3])
        K = np.linalg.solve(P[:3, :3] + np.eye(3) * sigma_mm**2, P[:3]).T
        gain = K @ off
        T = moved(self.T_kidney_camera, gain[:6])
        return replace(
            self, T_kidney_camera=_orthonormal(T), twist=self.twist + gain[6:], covariance=_symmetric(P - K @ P[:3])
        )

    def drawn(self, count: int, rng: np.random.Generator, least_mm: float = 0.0, least_deg: float = 0.0) -> Array:
        """Poses (count, 4, 4) drawn from the belief, as if it were less sure by so much."""
        P = self.covariance[:6, :6] + np.diag(np.repeat([least_mm, np.radians(least_deg)], 3) ** 2)
        steps = rng.multivariate_normal(np.zeros(6), P, count, method="cholesky")
        return np.array([moved(self.T_kidney_camera, step) for step in steps])


def _step_jacobian(R_step: Array, way: Array, dt: float) -> Array:
    """F (12, 12): what a step that turns by R and goes ``way`` (3,) does to errors."""
    F = np.eye(12)
    F[:3, :3] = F[3:6, 3:6] = R_step.T
    F[:3, 3:6] = -R_step.T @ _cross(way)
    F[:3, 6:9] = R_step.T * dt
    F[3:6, 9:] = np.eye(3) * dt
    return F


def _apart(T: Array, T_other: Array) -> Array:
    """(6,) position and turn of another pose in a pose's camera frame."""
    step = inverse(T) @ T_other
    return np.concatenate([step[:3, 3], Rotation.from_matrix(step[:3, :3]).as_rotvec()])


def moved(T: Array, step: Array) -> Array:
    """A pose (4, 4) moved by three mm and turned by three radians, (6,), in its camera frame."""
    return T @ transform_from(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3])


def _orthonormal(T: Array) -> Array:
    """Without the rounding errors that products gather."""
    return transform_from(Rotation.from_matrix(T[:3, :3]).as_matrix(), T[:3, 3])


def _cross(v: Array) -> Array:
    """(3, 3) so that ``_cross(v) @ x`` is v x x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _symmetric(P: Array) -> Array:
    return (P + P.T) / 2
