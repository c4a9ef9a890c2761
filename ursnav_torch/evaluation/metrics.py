"""How far located poses are from true ones: per frame, over a track, and in a form that other tools score.

Position, direction and needle error are those of virtual bronchoscopy (Merritt et al., Interactive CT-video
registration for the continuous guidance of bronchoscopy, IEEE TMI 2013).
Poses without an estimate are nan; they count as lost and enter no mean.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.geometry import angle_between, check_rigid, quaternion_from_transform

Array = NDArray[np.float64]

#: Farther from the truth than this, a track is lost.
LOST_MM = 10.0


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Errors of N poses; nan where there is no estimate.

    Attributes:
        position_mm: (N,) distance of the camera's places.
        direction: (N,) angle between the optical axes, radians.
        roll: (N,) angle about the optical axis that is left once the axes agree, radians, 0 to pi.
        needle_mm: (N,) distance of the points ``needle`` mm ahead of the camera.
    """

    position_mm: Array
    direction: Array
    roll: Array
    needle_mm: Array


def pose_errors(T_kidney_estimated: ArrayLike, T_kidney_true: ArrayLike, needle_mm: float = 10.0) -> PoseErrors:
    """Errors of estimated poses (N, 4, 4) against true ones (N, 4, 4).

    Args:
        T_kidney_estimated: camera poses; nan where there is none.
        T_kidney_true: the true camera poses.
        needle_mm: how far ahead of the camera the needle's tip is compared.

    Raises:
        ShapeError: the two differ in number or are no transforms.
        InputError: a pose is not rigid.
    """
    estimated, true = _checked(T_kidney_estimated, T_kidney_true)
    ahead = estimated[:, :3, 3] + needle_mm * estimated[:, :3, 2] - true[:, :3, 3] - needle_mm * true[:, :3, 2]
    return PoseErrors(
        np.linalg.norm(estimated[:, :3, 3] - true[:, :3, 3], axis=1),
        angle_between(estimated[:, :3, 2], true[:, :3, 2]),
        _twist(np.swapaxes(true[:, :3, :3], 1, 2) @ estimated[:, :3, :3]),
        np.linalg.norm(ahead, axis=1),
    )


def trajectory_error_mm(errors: PoseErrors) -> float:
    """Absolute trajectory error: root mean square of the position errors, without aligning; nan without any."""
    known = errors.position_mm[np.isfinite(errors.position_mm)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def success(errors: PoseErrors, within_mm: float) -> float:
    """Share of all frames whose position is known and right to ``within_mm``; nan without frames."""
    right = errors.position_mm <= within_mm
    return float(right.mean()) if len(right) else np.nan


def frames_to_loss(errors: PoseErrors, lost_mm: float = LOST_MM) -> float:
    """Mean number of frames in a row that are followed before the track is farther off than ``lost_mm``, or unknown.

    The last run counts although nothing ended it, so a track that is never lost gives its own length.
    """
    followed = np.concatenate([[False], errors.position_mm <= lost_mm, [False]])
    edges = np.flatnonzero(np.diff(followed.astype(int)))
    runs = edges[1::2] - edges[::2]
    return float(runs.mean()) if len(runs) else 0.0


def jitter_mm(T_kidney_estimated: ArrayLike, T_kidney_true: ArrayLike) -> float:
    """Mean change of the position's error from frame to frame, mm; a constant offset has none. nan without pairs.

    Estimated camera poses (N, 4, 4), nan where there is none, against true ones (N, 4, 4).
    """
    estimated, true = _checked(T_kidney_estimated, T_kidney_true)
    step = np.linalg.norm(np.diff(estimated[:, :3, 3] - true[:, :3, 3], axis=0), axis=1)
    step = step[np.isfinite(step)]
    return float(step.mean()) if len(step) else np.nan


def write_tum(path: str | Path, t_s: ArrayLike, T_kidney_camera: ArrayLike) -> None:
    """Write poses (N, 4, 4) at times (N,) in seconds as a TUM trajectory: ``t x y z qx qy qz qw``, in *meters*.

    Frames without a pose (nan) are left out. Tools such as evo read it.

    Raises:
        ShapeError: times and poses differ in number.
        InputError: a time is not finite.
    """
    t, T = np.asarray(t_s, float), np.asarray(T_kidney_camera, float)
    if T.ndim != 3 or T.shape[1:] != (4, 4) or t.shape != T.shape[:1]:
        raise ShapeError(f"Expected times (N,) and poses (N, 4, 4), got {t.shape} and {T.shape}.")
    known = np.isfinite(T).all((1, 2))
    if not np.isfinite(t[known]).all():
        raise InputError("A frame's time is not a finite number; a TUM trajectory needs seconds for every pose.")
    rows = np.column_stack([t[known], T[known, :3, 3] / 1000, quaternion_from_transform(T[known])])
    lines = [" ".join([f"{row[0]:.6f}", *(f"{v:.9f}" for v in row[1:])]) for row in rows]
    Path(path).write_text("".join(line + "\n" for line in lines), encoding="utf-8")


def _checked(T_kidney_estimated: ArrayLike, T_kidney_true: ArrayLike) -> tuple[Array, Array]:
    estimated, true = np.asarray(T_kidney_estimated, float), np.asarray(T_kidney_true, float)
    if estimated.ndim != 3 or estimated.shape[1:] != (4, 4) or estimated.shape != true.shape:
        raise ShapeError(f"Expected two sets of poses (N, 4, 4) alike, got {estimated.shape} and {true.shape}.")
    check_rigid(estimated[np.isfinite(estimated).all((1, 2))], "T_kidney_estimated")
    return estimated, check_rigid(true, "T_kidney_true")


def _twist(R: Array) -> Array:
    """Absolute angles (N,) of rotations (N, 3, 3) about z, after the shortest rotation between the z axes."""
    y, x = R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1]
    return np.abs(np.arctan2(y, x))
