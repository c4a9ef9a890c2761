"""Hand-eye calibration: where the EM sensor sits on the camera, and how far the two clocks are apart.

Robot-world and hand-eye at once (Shah, J. Mech. Robot. 5:031007, 2013, for poses): ``T_kidney_em p_em(t + offset) =
T_kidney_camera(t) o``, with the sensor's place ``o``, its axis or orientation in the camera frame, the registration and
the offset unknown together, by robust least squares. The errors of a track go on from picture to picture, so that the
uncertainty is the cluster-robust (sandwich) estimate over blocks of pictures, in its jackknife form CR3: each block is
judged by what the others predict of it (Bell and McCaffrey, Survey Methodology 28:169, 2002); without that, few blocks
are too sure of themselves.

An error of all poses along the optical axis, which is a place of the sensor along it, it cannot know: tracks of the
two videos that it was tried on stand 0.4 and 0.5 mm too far ahead. Weighing by the errors' correlation (generalized
least squares) was tried and is worse: it looks at changes from picture to picture, of which a track's are mostly
error, and so draws the sensor to the camera.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ursnav_torch.calibration.tip_problem import FEWEST, TipProblem, check_size, tip_problem
from ursnav_torch.em_log import EmSamples
from ursnav_torch.errors import RegistrationError

Array = NDArray[np.float64]

#: Root mean square errors that weigh the residuals: a track's position and a sensor's, mm; both directions, radians.
_POSITION_MM, _DIRECTION = 1.5, 0.1
#: Poses that are off by so many medians are a track gone astray, and are left out, in so many rounds at most: 2.5 and
#: 3.5 (0.33 mm) are better than Cauchy's law or a narrower bend (0.49 to 1.06 mm) where 6 % of a drive is up to 15 mm
#: off, and cost nothing where none is (``benchmarks.hand_eye first=100 astray=0.06``).
_ASTRAY, _ROUNDS = 2.5, 4
#: More pictures astray than this share are no calibration: tracks lose 5 to 14 %, mirrored logs leave out 30 %.
_MOST_ASTRAY = 0.25
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
#: A sensor farther from the camera than this is none on the tip, mm.
_FARTHEST_MM = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class TipCalibration:
    """The sensor on the camera.

    Attributes:
        offset_mm: (3,) the sensor in the camera frame, and its standard deviations.
        axis: (3,) its axis in the camera frame, NaN where the log has none; its standard deviation in degrees.
        R_camera_sensor: (3, 3) of a sensor with six degrees of freedom, or None.
        em_offset_s: the log's clock when the pictures' shows zero, and its standard deviation.
        T_kidney_em: (4, 4) the registration that goes with it.
        n: pictures with a reading that were used. astray: those left out, since their poses are far off.
        posed: pictures with a pose, with or without a reading.
        rms_mm: of the positions' residuals.
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
    astray: int
    posed: int
    rms_mm: float


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
        RegistrationError: too few pictures with a reading, no time in the log, too many pictures that agree with no
            motion of the sensor, or a motion that does not determine what is sought: the scope must turn and bend about
            more than one axis, and move.
    """
    problem = tip_problem(T_kidney_camera, t_s, samples)
    posed = len(problem.t_s)
    offset_s, used = _coarse_offset(problem)
    problem = problem.only(used)
    check_size(problem, samples.source)
    fit, problem = _robust_fit(_start(problem, offset_s), problem)
    raw = _residuals(fit.x, problem).reshape(-1, 6)
    rms_mm = float(np.sqrt(np.mean(np.sum((raw[:, :3] * _POSITION_MM) ** 2, axis=1))))
    found = _result(fit.x, _deviations(fit, problem), problem, rms_mm, int(used.sum()))
    _check(found)
    return replace(found, posed=posed)


def _coarse_offset(problem: TipProblem) -> tuple[float, NDArray[np.bool_]]:
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


def _start(problem: TipProblem, offset_s: float) -> Array:
    """(13,) turn and place of the registration about the path's middle, the sensor's place, its axis, the offset."""
    p, along = problem.readings(offset_s)
    o, R, t = _alternate(p, problem.R_camera, problem.place, 10)
    axis = np.median(np.einsum("nji,nj->ni", problem.R_camera, along @ R.T), axis=0)
    axis = axis if np.linalg.norm(axis) > 1e-6 else np.array([0.0, 0.0, 1.0])
    center = problem.position.mean(0)
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), R @ center + t - problem.middle, o, axis,
                           [offset_s]])  # fmt: skip


def _robust_fit(x: Array, problem: TipProblem) -> tuple[Any, TipProblem]:
    """The fit from a start (13,), and the poses that it believes: those far off are left out, and it fits again."""
    believed = problem
    for _ in range(_ROUNDS):
        fit = least_squares(_residuals, x, args=(believed,), loss="soft_l1", x_scale="jac", max_nfev=200)
        x = fit.x
        off = _residuals(x, problem).reshape(-1, 2, 3)
        length = np.linalg.norm(off, axis=2)
        kept = problem.only((length <= _ASTRAY * np.median(length, axis=0) + 1e-9).all(axis=1))
        if len(kept.t_s) == len(believed.t_s):
            break
        believed = kept
    return least_squares(_residuals, x, args=(believed,), loss="soft_l1", x_scale="jac", max_nfev=200), believed


def _residuals(x: Array, problem: TipProblem) -> Array:
    """(6 N,) of each pose: position and axis, in standard deviations; 0 where the log has no axis."""
    position, along = problem.readings(float(x[12]))
    R = Rotation.from_rotvec(x[:3]).as_matrix()
    seen = (position - problem.position.mean(0)) @ R.T + x[3:6] + problem.middle
    away = (seen - (problem.R_camera @ x[6:9] + problem.place)) / _POSITION_MM
    axis = x[9:12] / max(float(np.linalg.norm(x[9:12])), 1e-9)
    turned = (along @ R.T - problem.R_camera @ axis) / _DIRECTION
    return np.asarray(np.concatenate([away, turned if problem.has_axis else 0 * turned], axis=1)).ravel()


def _deviations(fit: Any, problem: TipProblem) -> Array:
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


def _result(x: Array, sd: Array, problem: TipProblem, rms_mm: float, had: int) -> TipCalibration:
    R, axis = Rotation.from_rotvec(x[:3]).as_matrix(), x[9:12] / np.linalg.norm(x[9:12])
    T = np.eye(4)
    spread = _PLACE_SPREAD * sd[6:9]
    T[:3, :3], T[:3, 3] = R, x[3:6] + problem.middle - R @ problem.position.mean(0)
    known = problem.has_axis
    across = sd[9:12] / np.linalg.norm(x[9:12])
    return TipCalibration(
        offset_mm=x[6:9], offset_sd_mm=spread, axis=axis if known else np.full(3, np.nan),
        axis_sd_deg=float(np.degrees(np.sqrt(np.sum(across**2) * 2 / 3))) if known else float("nan"),
        R_camera_sensor=_orientation(R, problem, float(x[12])), em_offset_s=float(x[12]), em_offset_sd_s=float(sd[12]),
        T_kidney_em=T, n=len(problem.t_s), astray=had - len(problem.t_s), posed=had, rms_mm=rms_mm,
    )  # fmt: skip


def _orientation(R_kidney_em: Array, problem: TipProblem, offset_s: float) -> Array | None:
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
    if found.astray > _MOST_ASTRAY * (found.n + found.astray):
        raise RegistrationError(
            f"{found.astray} of {found.n + found.astray} pictures do not agree with the others and the EM log: is the "
            "log mirrored (of a left-handed program), does it stand still for a time, or is it of another recording? "
            "Else the track is lost too often: record where the scope is localized well."
        )
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
