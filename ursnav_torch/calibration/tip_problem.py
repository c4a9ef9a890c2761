"""What hand-eye calibration is given: a recording's poses, and its EM log as a curve to take readings from."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ursnav_torch.em_log import EmSamples
from ursnav_torch.errors import RegistrationError

Array = NDArray[np.float64]

#: The log is smoothed over a bell of this standard deviation, s, with at most so many neighbors on either side.
_SMOOTH_S, _MOST_NEIGHBORS = 0.1, 40
#: Readings farther apart in time say nothing of what was between them, s.
_LARGEST_GAP_S = 0.5
#: More pictures than this say nothing new.
_MOST = 4000
#: The sensor's path and the camera's are of one size, but for where the one sits on the other: a path as long as this,
#: mm, is not so many times as long as the other.
_LONG_PATH_MM, _OTHER_SIZE = 25.0, 2.5
#: Fewer pictures with a reading do not make a calibration.
FEWEST = 40


@dataclass(frozen=True, slots=True, eq=False)
class TipProblem:
    """Poses as they are, and the log as a curve that readings at the poses' times are taken from.

    The log and not the track is interpolated: a track's errors go on from picture to picture, and between two of them
    there is less noise than in either, or more where speeds are estimated; either draws the clocks' offset to where
    most readings would then lie. The log, of more readings with errors of their own, makes a smooth curve.

    Attributes:
        t_s, place, R_camera: (N,), (N, 3), (N, 3, 3) the poses.
        clock, position, axis: (M,), (M, 3), (M, 3) the smoothed readings; the axis NaN where the log has none.
        quaternion: (M, 4) of a sensor with six degrees of freedom, as it was read.
        middle: (3,) of the places, whichever of them are left.
    """

    t_s: Array
    place: Array
    R_camera: Array
    clock: Array
    position: Array
    axis: Array
    quaternion: Array | None
    curve: CubicSpline
    middle: Array

    @property
    def has_axis(self) -> bool:
        """Whether the log has directions."""
        return bool(np.isfinite(self.axis).all())

    def inside(self, offset_s: float) -> NDArray[np.bool_]:
        """(N,) poses taken between two readings that follow each other."""
        t = self.t_s + offset_s
        j = np.clip(np.searchsorted(self.clock, t), 1, len(self.clock) - 1)
        gap = self.clock[j] - self.clock[j - 1]
        return np.asarray((t >= self.clock[0]) & (t <= self.clock[-1]) & (gap < _LARGEST_GAP_S))

    def readings(self, offset_s: float) -> tuple[Array, Array]:
        """Position (N, 3) and axis (N, 3) of the sensor at every pose; no axis is 0."""
        found = np.asarray(self.curve(self.t_s + offset_s))
        return found[:, :3], found[:, 3:]

    def only(self, rows: NDArray[np.bool_]) -> "TipProblem":
        """The same log with some of the poses."""
        return replace(self, t_s=self.t_s[rows], place=self.place[rows], R_camera=self.R_camera[rows])


def tip_problem(T: Array, t_s: Array, samples: EmSamples) -> TipProblem:
    """The problem of poses T_kidney_camera (N, 4, 4), NaN where there is none, at times (N,), and a log.

    Raises:
        RegistrationError: no time in the log, or too few poses or readings.
    """
    if samples.t_s is None:
        raise RegistrationError(f"{samples.source} has no times (t_s); the clocks' offset needs them.")
    posed = np.flatnonzero(np.isfinite(T).all(axis=(1, 2)) & np.isfinite(t_s))
    seen = np.flatnonzero(samples.seen & np.isfinite(samples.t_s))
    if len(posed) < FEWEST or len(seen) < FEWEST:
        raise RegistrationError(
            f"{len(posed)} pictures with a pose and {len(seen)} visible EM readings; at least {FEWEST} of each "
            "are needed, better some hundreds, with the scope turning and bending."
        )
    posed = posed[np.argsort(t_s[posed], kind="stable")][:: max(len(posed) // _MOST, 1)]
    seen = seen[np.unique(samples.t_s[seen], return_index=True)[1]]  # in order, each moment once
    visible = samples.rows(seen)
    clock = np.asarray(visible.t_s, float)
    has_axis = bool(np.isfinite(visible.axis).all())
    smooth = _smoothed(clock, np.hstack([visible.position_mm, visible.axis if has_axis else 0 * visible.position_mm]))
    axis = smooth[:, 3:] / np.linalg.norm(smooth[:, 3:], axis=1, keepdims=True) if has_axis else smooth[:, 3:]
    curve = CubicSpline(clock, np.hstack([smooth[:, :3], axis]))
    return TipProblem(
        t_s[posed], T[posed, :3, 3], T[posed, :3, :3], clock, smooth[:, :3],
        axis if has_axis else np.full_like(axis, np.nan), visible.quaternion, curve, T[posed, :3, 3].mean(0),
    )  # fmt: skip


def check_size(problem: TipProblem, source: str) -> None:
    """Refuse a log whose path is not of the poses' size: it is in another unit, or of another recording.

    Raises:
        RegistrationError: it is.
    """
    read, camera = (
        float(np.linalg.norm(np.subtract(*np.percentile(path, (90, 10), axis=0))))
        for path in (problem.position, problem.place)
    )
    if max(read, camera) > _LONG_PATH_MM and not 1 / _OTHER_SIZE < read / max(camera, 1e-9) < _OTHER_SIZE:
        raise RegistrationError(
            f"The readings of {source} spread over {read:.3g} mm, the camera's places over {camera:.3g} mm: they are "
            "not of one motion. Is the log in another unit (em_unit=mm, cm or m), or of another recording?"
        )


def _smoothed(clock: Array, values: Array) -> Array:
    """Values (M, C) by local quadratic regression over a bell of ``_SMOOTH_S`` of their neighbors in time (M,).

    A quadratic bends with the motion, where a mere mean would cut its corners.
    """
    step = float(np.median(np.diff(clock)))
    reach = int(np.clip(3 * _SMOOTH_S / max(step, 1e-6), 2, _MOST_NEIGHBORS))
    at = np.arange(len(clock))[:, None] + np.arange(-reach, reach + 1)
    there = (at >= 0) & (at < len(clock))
    at = np.clip(at, 0, len(clock) - 1)
    since = (clock[at] - clock[:, None]) / _SMOOTH_S
    weight = np.where(there, np.exp(-0.5 * since**2), 0.0)
    powers = np.stack([np.ones_like(since), since, since**2], axis=-1)
    normal = np.einsum("mk,mki,mkj->mij", weight, powers, powers) + 1e-9 * np.eye(3)
    right = np.einsum("mk,mki,mkc->mic", weight, powers, values[at])
    return np.asarray(np.linalg.solve(normal, right)[:, 0])
