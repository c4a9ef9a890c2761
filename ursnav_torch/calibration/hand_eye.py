"""Hand-eye calibration: where the EM sensor sits on the camera, and how far the two clocks are apart.

Robot-world and hand-eye at once (Shah, J. Mech. Robot. 5:031007, 2013, for poses): ``T_kidney_em p_em(t + offset) =
T_kidney_camera(t) o``, with the sensor's place ``o``, its axis or orientation in the camera frame, the registration and
the offset unknown together, by robust least squares. The errors of a track go on from picture to picture, so that the
uncertainty is the cluster-robust (sandwich) estimate over blocks of pictures, in its jackknife form CR3: each block is
judged by what the others predict of it (Bell and McCaffrey, Survey Methodology 28:169, 2002); without that, few blocks
are too sure of themselves. Weighing by the errors' correlation (generalized least squares) was tried and is worse: it
looks at changes from picture to picture, of which a track's are mostly error, and so draws the sensor to the camera.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ursnav_torch.em_log import EmSamples
from ursnav_torch.errors import RegistrationError

Array = NDArray[np.float64]

#: Root mean square errors that weigh the residuals: a track's position and a sensor's, mm; both directions, radians.
_POSITION_MM, _DIRECTION = 1.5, 0.1
#: Errors of a track are taken as one for so long, s.
_BLOCK_S = 4.0
#: The place's spread is larger than the blocks tell, whatever their length, since poses stand on both sides of the
#: equation: root mean square of misses in standard deviations, 25 drives of other seeds than those judged, over
#: 120 and 240 s 1.39 and 1.33 (``benchmarks.hand_eye first=100``).
_PLACE_SPREAD = 1.35
#: Offsets between the clocks that are tried, s.
_SEARCH_S, _STEP_S = 3.0, 0.05
#: A calibration that is less certain is refused: standard deviations, mm, degrees and s.
LARGEST_SD_MM, LARGEST_SD_DEG, LARGEST_SD_S = 1.0, 3.0, 0.05
#: The log is smoothed over a bell of this standard deviation, s, with at most so many neighbors on either side.
_SMOOTH_S, _MOST_NEIGHBORS = 0.1, 40
#: Readings farther apart in time say nothing of what was between them, s.
_LARGEST_GAP_S = 0.5
#: More pictures than this say nothing new; a sensor farther from the camera than this is none on the tip, mm.
_MOST, _FARTHEST_MM = 4000, 50.0
#: The sensor's path and the camera's are of one size, but for where the one sits on the other: a path as long as this,
#: mm, is not so many times as long as the other.
_LONG_PATH_MM, _OTHER_SIZE = 25.0, 2.5
#: Fewer pictures with a reading do not make a calibration.
FEWEST = 40


@dataclass(frozen=True, slots=True, eq=False)
class TipCalibration:
    """The sensor on the camera.

    Attributes:
        offset_mm: (3,) the sensor in the camera frame, and its standard deviations.
        axis: (3,) its axis in the camera frame, NaN where the log has none; its standard deviation in degrees.
        R_camera_sensor: (3, 3) of a sensor with six degrees of freedom, or None.
        em_offset_s: the log's clock when the pictures' shows zero, and its standard deviation.
        T_kidney_em: (4, 4) the registration that goes with it.
        n: pictures with a reading. rms_mm: of the positions' residuals.
    """

    offset_mm: Array
    offset_sd_mm: Array
    axis: Array
    axis_sd_deg: float
    R_camera_sensor: Array | None
    em_offset_s: float
    em_offset_sd_s: float
    T_kidney_em: Array
    n: int
    rms_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Poses as they are, and the log as a curve that readings at the poses' times are taken from.

    The log and not the track is interpolated: a track's errors go on from picture to picture, and between two of them
    there is less noise than in either, or more where speeds are estimated; either draws the clocks' offset to where
    most readings would then lie. The log, of more readings with errors of their own, makes a smooth curve.

    Attributes:
        t_s, place, R_camera: (N,), (N, 3), (N, 3, 3) the poses.
        clock, position, axis: (M,), (M, 3), (M, 3) the smoothed readings; the axis NaN where the log has none.
        quaternion: (M, 4) of a sensor with six degrees of freedom, as it was read.
    """

    t_s: Array
    place: Array
    R_camera: Array
    clock: Array
    position: Array
    axis: Array
    quaternion: Array | None
    curve: CubicSpline

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

    def only(self, rows: NDArray[np.bool_]) -> "_Problem":
        """The same log with some of the poses."""
        return replace(self, t_s=self.t_s[rows], place=self.place[rows], R_camera=self.R_camera[rows])


#: Directions of so much less information than the best (in columns of one length) are none, and a parameter that has
#: more than this share of them is free: rounding stays far below the one, and a motion that tells far above the other.
_SINGULAR, _FREE_SHARE = 1e-10, 1e-3


def calibrate_tip(T_kidney_camera: Array, t_s: Array, samples: EmSamples) -> TipCalibration:
    """The sensor's place on the camera and the clocks' offset, from a localized recording and its EM log.

    Args:
        T_kidney_camera: (N, 4, 4) poses; NaN where there is none.
        t_s: (N,) their times.
        samples: the log, with times.

    Raises:
        RegistrationError: too few pictures with a reading, no time in the log, or a motion that does not determine what
            is sought: the scope must turn and bend about more than one axis, and move.
    """
    problem = _problem(T_kidney_camera, t_s, samples)
    offset_s, used = _coarse_offset(problem)
    problem = problem.only(used)
    _check_size(problem, samples.source)
    x = _start(problem, offset_s)
    fit = least_squares(_residuals, x, args=(problem,), loss="soft_l1", x_scale="jac", max_nfev=200)
    raw = _residuals(fit.x, problem).reshape(-1, 6)
    rms_mm = float(np.sqrt(np.mean(np.sum((raw[:, :3] * _POSITION_MM) ** 2, axis=1))))
    found = _result(fit.x, _deviations(fit, problem), problem, rms_mm)
    _check(found)
    return found


def _problem(T: Array, t_s: Array, samples: EmSamples) -> _Problem:
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
    return _Problem(
        t_s[posed], T[posed, :3, 3], T[posed, :3, :3], clock, smooth[:, :3],
        axis if has_axis else np.full_like(axis, np.nan), visible.quaternion, curve,
    )  # fmt: skip


def _check_size(problem: _Problem, source: str) -> None:
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


def _coarse_offset(problem: _Problem) -> tuple[float, NDArray[np.bool_]]:
    """The offset at which a rigid motion takes the sensor's path best to the camera's, and the readings that count."""
    begin = float(problem.clock[0] - problem.t_s[0])
    middle = begin if abs(begin) > 60 else 0.0
    best, kept = (np.inf, 0.0), np.zeros(len(problem.t_s), bool)
    for offset in middle + np.arange(-_SEARCH_S, _SEARCH_S + 1e-9, _STEP_S):
        ok = problem.inside(float(offset))
        if ok.sum() < FEWEST:
            continue
        part = problem.only(ok)
        position, _ = part.readings(float(offset))
        o, R, t = _alternate(position, part.R_camera, part.place, 3)
        off = np.linalg.norm(position @ R.T + t - (part.R_camera @ o + part.place), axis=1)
        if (miss := float(np.median(off))) < best[0]:
            best, kept = (miss, float(offset)), ok
    if not np.isfinite(best[0]):
        raise RegistrationError(
            f"The log runs from {problem.clock[0]:.2f} to {problem.clock[-1]:.2f} s, the pictures from "
            f"{problem.t_s[0]:.2f} to {problem.t_s[-1]:.2f} s: they do not overlap within {_SEARCH_S:g} s of offset. "
            "Say em_offset_s=, what the log's clock shows when the pictures' shows zero."
        )
    return best[1], kept


def _alternate(p: Array, R_camera: Array, place: Array, rounds: int) -> tuple[Array, Array, Array]:
    """Sensor's place and registration in turns: the rotation by Kabsch, then the two translations, which are linear."""
    o, R, t = np.zeros(3), np.eye(3), np.zeros(3)
    A = np.concatenate([R_camera, np.broadcast_to(-np.eye(3), (len(p), 3, 3))], axis=2).reshape(-1, 6)
    for _ in range(rounds):
        q = R_camera @ o + place
        a, b = p - p.mean(0), q - q.mean(0)
        U, _, Vt = np.linalg.svd(b.T @ a)
        R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
        found = np.linalg.lstsq(A, (p @ R.T - place).ravel(), rcond=1e-6)[0]
        o, t = found[:3], found[3:]
        if np.linalg.norm(o) > _FARTHEST_MM:  # a motion that says nothing of it
            o = o * _FARTHEST_MM / np.linalg.norm(o)
    return o, R, t


def _start(problem: _Problem, offset_s: float) -> Array:
    """(13,) turn and place of the registration about the path's middle, the sensor's place, its axis, the offset."""
    p, along = problem.readings(offset_s)
    o, R, t = _alternate(p, problem.R_camera, problem.place, 10)
    axis = np.median(np.einsum("nji,nj->ni", problem.R_camera, along @ R.T), axis=0)
    axis = axis if np.linalg.norm(axis) > 1e-6 else np.array([0.0, 0.0, 1.0])
    center = problem.position.mean(0)
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), R @ center + t - problem.place.mean(0), o, axis,
                           [offset_s]])  # fmt: skip


def _residuals(x: Array, problem: _Problem) -> Array:
    """(6 N,) of each pose: position and axis, in standard deviations; 0 where the log has no axis."""
    position, along = problem.readings(float(x[12]))
    R = Rotation.from_rotvec(x[:3]).as_matrix()
    seen = (position - problem.position.mean(0)) @ R.T + x[3:6] + problem.place.mean(0)
    away = (seen - (problem.R_camera @ x[6:9] + problem.place)) / _POSITION_MM
    axis = x[9:12] / max(float(np.linalg.norm(x[9:12])), 1e-9)
    turned = (along @ R.T - problem.R_camera @ axis) / _DIRECTION
    return np.asarray(np.concatenate([away, turned if problem.has_axis else 0 * turned], axis=1)).ravel()


def _deviations(fit: Any, problem: _Problem) -> Array:
    """(13,) standard deviations: CR3 over blocks of pictures, and no less than the classical ones."""
    J, r = fit.jac, fit.fun
    times = problem.t_s
    block = np.repeat(((times - times[0]) // _BLOCK_S).astype(int), 6)
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-12)
    meat = np.zeros_like(inverse)
    blocks = np.unique(block)
    for number in blocks:
        own = J[block == number]
        score = own.T @ r[block == number]
        without = np.linalg.lstsq(np.eye(len(inverse)) - own.T @ own @ inverse, score, rcond=1e-9)[0]
        meat += np.outer(without, without)
    sandwich = inverse @ meat @ inverse * (len(blocks) - 1) / len(blocks)
    classical = inverse * float(np.mean(r**2))
    sd = np.sqrt(np.maximum(np.maximum(np.diag(sandwich), np.diag(classical)), 0))
    return np.where(_undetermined(J), np.inf, sd)


def _undetermined(J: Array) -> NDArray[np.bool_]:
    """Which parameters (13,) the readings leave free: those in the null space of J (6 N, 13), by columns of one length.

    The axis's own length is free by design; the pseudo-inverse would give what is free no spread at all.
    """
    length = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    values, vectors = np.linalg.eigh((J / length).T @ (J / length))
    free = np.square(vectors[:, values < _SINGULAR * values[-1]]).sum(axis=1) > _FREE_SHARE
    free[9:12] = False
    return np.asarray(free, bool)


def _result(x: Array, sd: Array, problem: _Problem, rms_mm: float) -> TipCalibration:
    R, axis = Rotation.from_rotvec(x[:3]).as_matrix(), x[9:12] / np.linalg.norm(x[9:12])
    T = np.eye(4)
    spread = _PLACE_SPREAD * sd[6:9]
    T[:3, :3], T[:3, 3] = R, x[3:6] + problem.place.mean(0) - R @ problem.position.mean(0)
    known = problem.has_axis
    across = sd[9:12] / np.linalg.norm(x[9:12])
    return TipCalibration(
        offset_mm=x[6:9], offset_sd_mm=spread, axis=axis if known else np.full(3, np.nan),
        axis_sd_deg=float(np.degrees(np.sqrt(np.sum(across**2) * 2 / 3))) if known else float("nan"),
        R_camera_sensor=_orientation(R, problem, float(x[12])), em_offset_s=float(x[12]), em_offset_sd_s=float(sd[12]),
        T_kidney_em=T, n=len(problem.t_s), rms_mm=rms_mm,
    )  # fmt: skip


def _orientation(R_kidney_em: Array, problem: _Problem, offset_s: float) -> Array | None:
    """The mean orientation of a sensor with six degrees of freedom in the camera frame."""
    if problem.quaternion is None:
        return None
    t = problem.t_s + offset_s
    j = np.clip(np.searchsorted(problem.clock, t), 1, len(problem.clock) - 1)
    nearest = np.where(t - problem.clock[j - 1] < problem.clock[j] - t, j - 1, j)
    ok = np.isfinite(problem.quaternion[nearest]).all(axis=1)
    R_em_sensor = Rotation.from_quat(problem.quaternion[nearest[ok]]).as_matrix()
    R = np.swapaxes(problem.R_camera[ok], 1, 2) @ R_kidney_em @ R_em_sensor
    return np.asarray(Rotation.from_matrix(R).mean().as_matrix())


def _check(found: TipCalibration) -> None:
    sd = float(np.linalg.norm(found.offset_sd_mm) / np.sqrt(3))
    unknown = [
        text
        for uncertain, text in (
            (not sd < LARGEST_SD_MM, f"the sensor's place (uncertain by {sd:.1f} mm)"),
            (found.axis_sd_deg > LARGEST_SD_DEG, f"its axis (by {found.axis_sd_deg:.1f} degrees)"),
            (not found.em_offset_sd_s < LARGEST_SD_S, f"the clocks' offset (by {1e3 * found.em_offset_sd_s:.0f} ms)"),
        )
        if uncertain
    ]
    if np.linalg.norm(found.offset_mm) > _FARTHEST_MM and not unknown:
        unknown = [f"the sensor's place (found {np.linalg.norm(found.offset_mm):.0f} mm from the camera)"]
    if unknown:
        raise RegistrationError(
            f"The motion does not determine {' and '.join(unknown)}: record the scope moving in and out while it bends "
            "to all sides and rolls, for four minutes or more, where it is localized well."
        )
