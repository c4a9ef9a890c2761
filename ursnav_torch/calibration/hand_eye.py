"""Hand-eye calibration: where the EM sensor sits on the camera, and how far the two clocks are apart.

Robot-world and hand-eye at once (Shah, J. Mech. Robot. 5:031007, 2013, for poses): ``T_kidney_em p_em(t + offset) =
T_kidney_camera(t) o``, with the sensor's place ``o``, its axis or orientation in the camera frame, the registration and
the offset unknown together, by robust least squares. The uncertainty is the sandwich estimate over blocks of pictures,
since the errors of a track go on from picture to picture.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ursnav_torch.em_log import EmSamples
from ursnav_torch.errors import RegistrationError

Array = NDArray[np.float64]

#: Root mean square errors that weigh the residuals: a track's position and a sensor's, mm; both directions, radians.
_POSITION_MM, _DIRECTION = 1.5, 0.1
#: Errors of a track are taken as one for so long, s.
_BLOCK_S = 4.0
#: Offsets between the clocks that are tried, s.
_SEARCH_S, _STEP_S = 3.0, 0.05
#: A calibration that is less certain is refused: standard deviations, mm, degrees and s.
LARGEST_SD_MM, LARGEST_SD_DEG, LARGEST_SD_S = 1.0, 3.0, 0.05
#: A pose's speed is that of its neighbors, weighed by a bell of so many pictures.
_SPEED_OVER = 2.0
#: Poses farther apart in time do not say where the camera was between them, s.
_LARGEST_GAP_S = 0.5
#: More readings than this say nothing new; a sensor farther from the camera than this is none on the tip, mm.
_MOST, _FARTHEST_MM = 4000, 50.0
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
        n: readings used. rms_mm: of the positions' residuals.
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
    """Poses with times, and the visible readings in order of time.

    Readings are taken as they are, and places from the nearest pose on with its speed: between two, by a straight line,
    there is less noise than in either, which draws the clocks' offset to where most readings lie between.
    """

    t_s: Array
    place: Array
    speed: Array
    turn: Array
    clock: Array
    position: Array
    axis: Array
    quaternion: Array | None
    near: NDArray[np.int64] | None = None

    def anchored(self, offset_s: float) -> "_Problem":
        """The same, with every reading's nearest pose held, so that what follows is smooth in the offset."""
        t = self.clock - offset_s
        j = np.clip(np.searchsorted(self.t_s, t), 1, len(self.t_s) - 1)
        return replace(self, near=np.where(t - self.t_s[j - 1] < self.t_s[j] - t, j - 1, j))

    def inside(self, offset_s: float) -> NDArray[np.bool_]:
        """(M,) readings taken between two poses that follow each other."""
        t = self.clock - offset_s
        j = np.clip(np.searchsorted(self.t_s, t), 1, len(self.t_s) - 1)
        gap = self.t_s[j] - self.t_s[j - 1]
        return np.asarray((t >= self.t_s[0]) & (t <= self.t_s[-1]) & (gap < _LARGEST_GAP_S))

    def camera(self, offset_s: float) -> tuple[Array, Array]:
        """Rotation (M, 3, 3) and place (M, 3) of the camera at every reading."""
        t = self.clock - offset_s
        j = np.clip(np.searchsorted(self.t_s, t), 1, len(self.t_s) - 1)
        w = ((t - self.t_s[j - 1]) / np.maximum(self.t_s[j] - self.t_s[j - 1], 1e-9))[:, None]
        q = self.turn[j - 1] * (1 - w) + self.turn[j] * w
        i = np.where(w[:, 0] < 0.5, j - 1, j) if self.near is None else self.near
        return Rotation.from_quat(q).as_matrix(), self.place[i] + self.speed[i] * (t - self.t_s[i])[:, None]

    def only(self, rows: NDArray[np.bool_]) -> "_Problem":
        """The same poses with some of the readings."""
        q = None if self.quaternion is None else self.quaternion[rows]
        return replace(self, clock=self.clock[rows], position=self.position[rows], axis=self.axis[rows], quaternion=q)


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
    x = _start(problem, offset_s)
    for _ in range(2):
        problem = problem.anchored(float(x[12]))
        fit = least_squares(_residuals, x, args=(problem,), loss="soft_l1", x_scale="jac", max_nfev=200)
        x = fit.x
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
    posed = posed[np.argsort(t_s[posed], kind="stable")]
    visible = samples.rows(seen[np.argsort(samples.t_s[seen], kind="stable")][:: max(len(seen) // _MOST, 1)])
    turn = Rotation.from_matrix(T[posed, :3, :3]).as_quat()
    signs = np.cumprod(np.where(np.sum(turn[1:] * turn[:-1], axis=1) < 0, -1, 1))
    turn[1:] *= signs[:, None]  # neighbors on one side, so that between them is between them
    clock = np.asarray(visible.t_s, float)
    smooth = gaussian_filter1d(T[posed, :3, 3], _SPEED_OVER, axis=0, mode="nearest")
    speed = np.gradient(smooth, t_s[posed], axis=0)
    return _Problem(
        t_s[posed], T[posed, :3, 3], speed, turn, clock, visible.position_mm, visible.axis, visible.quaternion
    )


def _coarse_offset(problem: _Problem) -> tuple[float, NDArray[np.bool_]]:
    """The offset at which a rigid motion takes the sensor's path best to the camera's, and the readings that count."""
    begin = float(problem.clock[0] - problem.t_s[0])
    middle = begin if abs(begin) > 60 else 0.0
    best, kept = (np.inf, 0.0), np.zeros(len(problem.clock), bool)
    for offset in middle + np.arange(-_SEARCH_S, _SEARCH_S + 1e-9, _STEP_S):
        ok = problem.inside(float(offset))
        if ok.sum() < FEWEST:
            continue
        part = problem.only(ok)
        R_camera, place = part.camera(float(offset))
        o, R, t = _alternate(part.position, R_camera, place, 3)
        off = np.linalg.norm(part.position @ R.T + t - (R_camera @ o + place), axis=1)
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
    p, (R_camera, place) = problem.position, problem.camera(offset_s)
    o, R, t = _alternate(p, R_camera, place, 10)
    axis = np.zeros(3)
    if (known := np.isfinite(problem.axis).all(axis=1)).any():
        axis = np.median(np.einsum("nji,nj->ni", R_camera[known], problem.axis[known] @ R.T), axis=0)
    axis = axis if np.linalg.norm(axis) > 1e-6 else np.array([0.0, 0.0, 1.0])
    middle = R @ p.mean(0) + t - problem.place.mean(0)
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), middle, o, axis, [offset_s]])


def _residuals(x: Array, problem: _Problem) -> Array:
    """(6 M,) of each reading: position and axis, in standard deviations; 0 where the log has no axis."""
    R_camera, place = problem.camera(float(x[12]))
    R = Rotation.from_rotvec(x[:3]).as_matrix()
    seen = (problem.position - problem.position.mean(0)) @ R.T + x[3:6] + problem.place.mean(0)
    away = (seen - (R_camera @ x[6:9] + place)) / _POSITION_MM
    axis = x[9:12] / max(float(np.linalg.norm(x[9:12])), 1e-9)
    turned = (problem.axis @ R.T - R_camera @ axis) / _DIRECTION
    return np.asarray(np.concatenate([away, np.nan_to_num(turned)], axis=1)).ravel()


def _deviations(fit: Any, problem: _Problem) -> Array:
    """(13,) standard deviations: sandwich over blocks of readings, and no less than the classical ones."""
    J, r = fit.jac, fit.fun
    block = ((problem.clock - problem.clock[0]) // _BLOCK_S).astype(int)
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-12)
    scores = np.zeros((block.max() + 1, J.shape[1]))
    np.add.at(scores, np.repeat(block, 6), J * r[:, None])
    count = len(np.unique(block))
    sandwich = inverse @ (scores.T @ scores) @ inverse * count / max(count - J.shape[1] / 3, 1.0)
    classical = inverse * float(np.mean(r**2))
    sd = np.sqrt(np.maximum(np.maximum(np.diag(sandwich), np.diag(classical)), 0))
    return np.where(_undetermined(J), np.inf, sd)


def _undetermined(J: Array) -> NDArray[np.bool_]:
    """Which parameters (13,) the readings leave free: those in the null space of J (6 M, 13), by columns of one length.

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
    T[:3, :3], T[:3, 3] = R, x[3:6] + problem.place.mean(0) - R @ problem.position.mean(0)
    known = bool(np.isfinite(problem.axis).all(axis=1).any())
    across = sd[9:12] / np.linalg.norm(x[9:12])
    return TipCalibration(
        offset_mm=x[6:9], offset_sd_mm=sd[6:9], axis=axis if known else np.full(3, np.nan),
        axis_sd_deg=float(np.degrees(np.sqrt(np.sum(across**2) * 2 / 3))) if known else float("nan"),
        R_camera_sensor=_orientation(R, problem, float(x[12])), em_offset_s=float(x[12]), em_offset_sd_s=float(sd[12]),
        T_kidney_em=T, n=len(problem.clock), rms_mm=rms_mm,
    )  # fmt: skip


def _orientation(R_kidney_em: Array, problem: _Problem, offset_s: float) -> Array | None:
    """The mean orientation of a sensor with six degrees of freedom in the camera frame."""
    if problem.quaternion is None:
        return None
    ok = np.isfinite(problem.quaternion).all(axis=1)
    R_camera, _ = problem.camera(offset_s)
    R = np.swapaxes(R_camera[ok], 1, 2) @ R_kidney_em @ Rotation.from_quat(problem.quaternion[ok]).as_matrix()
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
            "to all sides and rolls, for a minute or more, where it is localized well."
        )
