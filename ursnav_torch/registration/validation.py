"""Is the match right? The EM sensor's verdict: the thesis's rule on positions, and one on position and direction.

A 5-DoF sensor measures where it is and where it points, all but its roll. The thesis compares positions alone
(Eq. 3.2, 4.1-4.4) and takes a view of the neighboring calyx from the same place for right; the direction tells them
apart. Lengths are mm of the kidney as given: a phantom printed 1.8 times larger has thresholds 1.8 times anatomy's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.geometry import Array, angle_between, check_rigid
from ursnav_torch.registration.result import Registration, skew


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Root mean square errors of what is compared, besides the registration's own.

    Attributes:
        em_mm: position of the sensor, mm of the EM frame (Aurora 5-DoF: 0.7, thesis section 4.3.2).
        em_axis_deg: direction of its axis.
        match_mm: position of a right match, match_axis_deg: its optical axis. Generous for a localizer with medians of
            0.6 mm and 5.5 degrees (`python -m benchmarks.accuracy`), since its errors have tails.
    """

    em_mm: float = 0.7
    em_axis_deg: float = 0.6
    match_mm: float = 1.5
    match_axis_deg: float = 10.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}.")


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """N matches beside the sensor's readings.

    Attributes:
        distance_mm: (N,) between the sensor and the place where the matched pose would have it.
        angle_rad: (N,) between the sensor's axis and the matched optical axis; NaN where no axis was read.
        expected_mm: (N,) root mean square distance of a right match.
        p: (N,) probability that a right match differs so much in position and direction; in position alone where no
            axis was read.
    """

    distance_mm: Array
    angle_rad: Array
    expected_mm: Array
    p: Array


@dataclass(frozen=True, slots=True)
class Confusion:
    """How often a verdict ("the match is right") agrees with the truth; thesis Eq. 6.1."""

    TP: int
    FN: int
    FP: int
    TN: int

    @property
    def balanced_accuracy(self) -> float:
        """Mean of the parts of right matches confirmed and of wrong ones exposed; NaN without either."""
        right, wrong = self.TP + self.FN, self.FP + self.TN
        return 0.5 * (self.TP / right + self.TN / wrong) if right and wrong else float("nan")


def camera_errors(registration: Registration, em_mm: ArrayLike, camera_mm: ArrayLike) -> Array:
    """(N,) distances ``e_cam`` of sensors (N, 3), EM frame, from virtual cameras (N, 3), kidney frame (Eq. 4.2)."""
    em, camera = np.asarray(em_mm, float), np.asarray(camera_mm, float)
    if em.shape != camera.shape or em.ndim != 2 or em.shape[-1] != 3:
        raise ShapeError(f"Reference pairs must be two sets (N, 3), got {em.shape} and {camera.shape}.")
    return np.linalg.norm(registration.apply(em) - camera, axis=1)


def position_threshold(e_cam_mm: ArrayLike, em_mm: float = 0.7) -> float:
    """Largest distance of a right match, mm: mean and deviation of ``e_cam`` (N,) plus the sensor's error, Eq. 4.3-4.4.

    The registration's error is in ``e_cam`` already; ``em_mm`` is in mm of the kidney, as ``e_cam`` is. The deviation
    is the sample's (n - 1), as in table 5.2.

    Raises:
        InputError: fewer than two reference pairs, or a value that is not finite.
    """
    e = np.asarray(e_cam_mm, float).ravel()
    if len(e) < 2 or not np.all(np.isfinite(e)):
        raise InputError(f"The threshold needs at least two finite reference errors (the thesis took five), got {e}.")
    return float(e.mean() + e.std(ddof=1) + em_mm)


def compare_poses(
    T_kidney_camera: ArrayLike,
    sensor_em: ArrayLike,
    axis_em: ArrayLike,
    registration: Registration,
    sensor_offset_mm: ArrayLike,
    budget: ErrorBudget,
) -> Comparison:
    """Compare matched poses with the sensor's readings.

    Were the match right, the difference in position (3 numbers) and in direction (2) would be normal about zero, with
    the covariance of the registration (a small turn and shift of everything), of the sensor and of the matching; the
    p-value is that of its Mahalanobis distance, chi-squared with 5 (or 3) degrees of freedom.

    Args:
        T_kidney_camera: (N, 4, 4) matched poses.
        sensor_em: (N, 3) sensor positions, EM frame; axis_em: (N, 3) axes, NaN rows where they are not known.
        registration: EM to kidney.
        sensor_offset_mm: (3,) sensor in the camera frame, mm of the EM frame.
        budget: root mean square errors.

    Raises:
        ShapeError: the shapes do not fit.
        InputError: a pose is not rigid.
    """
    T = check_rigid(T_kidney_camera, "T_kidney_camera")
    sensor, axis = np.asarray(sensor_em, float), np.asarray(axis_em, float)
    offset = np.asarray(sensor_offset_mm, float)
    if T.ndim != 3 or not len(T) == len(sensor) == len(axis) or offset.shape != (3,):
        raise ShapeError(
            f"Expected poses (N, 4, 4), positions and axes (N, 3) and an offset (3,), got {T.shape}, {sensor.shape}, "
            f"{axis.shape} and {offset.shape}."
        )
    measured, direction = registration.apply(sensor), registration.apply_direction(axis)
    arm = T[:, :3, :3] @ (registration.scale * offset)
    away = T[:, :3, 3] + arm - measured
    covariance = _covariance(measured, arm, registration, budget)
    p = chi2.sf(_mahalanobis(away, covariance[:, :3, :3]), 3)
    seen = np.isfinite(direction).all(axis=1)
    p[seen] = chi2.sf(_mahalanobis(*_five_numbers(away[seen], direction[seen], T[seen, :3, 2], covariance[seen])), 5)
    return Comparison(
        distance_mm=np.linalg.norm(away, axis=1),
        angle_rad=angle_between(direction, T[:, :3, 2]),
        expected_mm=np.sqrt(np.trace(covariance[:, :3, :3], axis1=1, axis2=2)),
        p=p,
    )


def confusion(right: ArrayLike, judged_right: ArrayLike) -> Confusion:
    """Count matches (N,) by truth and verdict."""
    t, v = np.asarray(right, bool), np.asarray(judged_right, bool)
    return Confusion(int(np.sum(t & v)), int(np.sum(t & ~v)), int(np.sum(~t & v)), int(np.sum(~t & ~v)))


def _five_numbers(away: Array, measured: Array, matched: Array, covariance: Array) -> tuple[Array, Array]:
    """Difference in position and the turn (about two axes across it) from the measured to the matched direction.

    The third axis, roll, is not measured. Returns (N, 5) and its covariance (N, 5, 5).
    """
    cross = np.cross(measured, matched)
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    other = np.where(np.abs(measured[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.where(sine > 1e-6, cross, np.cross(measured, other))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    pick = np.zeros((len(away), 5, 6))
    pick[:, :3, :3], pick[:, 3, 3:], pick[:, 4, 3:] = np.eye(3), first, np.cross(measured, first)
    x = np.c_[away, angle_between(measured, matched), np.zeros(len(away))]
    return x, pick @ covariance @ np.swapaxes(pick, 1, 2)


def _covariance(sensor: Array, arm: Array, registration: Registration, budget: ErrorBudget) -> Array:
    """(N, 6, 6) covariance of the differences in position (mm) and direction (rotation vector, rad).

    A wrong optical axis moves the place of the sensor too, by its distance from the camera.
    """
    N, eye = len(sensor), np.eye(3)
    position = ((registration.scale * budget.em_mm) ** 2 + budget.match_mm**2) / 3 * eye
    turn = (np.radians(budget.match_axis_deg) ** 2 / 2) * eye
    lever = np.concatenate([-skew(arm), np.broadcast_to(eye, (N, 3, 3))], axis=1)
    C = lever @ turn @ np.swapaxes(lever, 1, 2)
    C[:, :3, :3] += position
    C[:, 3:, 3:] += np.radians(budget.em_axis_deg) ** 2 / 2 * eye
    if registration.covariance is None or registration.center_mm is None:
        C[:, :3, :3] += registration.error_covariance(sensor)
        return C
    J = np.zeros((N, 6, 6))
    J[:, :3, :3], J[:, :3, 3:], J[:, 3:, :3] = -skew(sensor - registration.center_mm), eye, eye
    return C + J @ registration.covariance @ np.swapaxes(J, 1, 2)


def _mahalanobis(x: Array, covariance: Array) -> Array:
    return np.einsum("ni,ni->n", x, np.linalg.solve(covariance, x[..., None])[..., 0])
