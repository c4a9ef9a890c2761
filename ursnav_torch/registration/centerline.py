"""Registration from the sensor's own path: no landmark is touched.

As in bronchoscopy, the path of the tip is laid into the tree of the lumen by position and direction (CustusX registers
its centerline so, from a starting guess). Here two cues do most of the work and need no guess: the sensor, and the
optical axis ahead of it, are never outside the lumen; and over a whole exploration they keep to its middle. That the
axis points along the branch, away from the pelvis, tells one end of the tree from the other.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from torch import Tensor

from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import Array, angle_between
from ursnav_torch.kidney import Centerline
from ursnav_torch.registration.field import DistanceField
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.search import Misfit, Poses, as_tensor
from ursnav_torch.registration.solve import (
    PARTS,
    Problem,
    Solution,
    refuse_if_mirrored_fits,
    refuse_unless_determined,
    solve,
)

#: Samples are averaged until the tip has moved this far, mm.
_STEP_MM = 1.5
#: Fewer averaged samples than this are no exploration.
_LEAST_SAMPLES = 12
#: Samples of the coarse search, and spacing of the places tried on the centerline, mm.
_COARSE_SAMPLES, _ANCHOR_MM = 40, 3.0
#: A place counts as outside from 0.3 mm before the wall on (the sensor's noise), costs by its square over 0.5 mm, and
#: beyond 2 mm linearly, so that a bad stretch of the path doesn't decide.
_NOISE_MM, _WALL_MM, _SOFT_MM = 0.3, 0.5, 2.0
#: Distance from the deepest place, linear beyond 1 mm: off the middle costs a little everywhere.
_MIDDLE_MM = 1.0
#: Spread of the axis about the branch's direction, and the part of the samples that must follow it (CustusX: 70 %).
_HEADING_RAD, _HEADING_PART = 1.0, 0.7
#: A path with a larger part of its samples more than 1 mm outside the lumen does not belong into this kidney.
_MOST_OUTSIDE = 0.05
#: Nor does one that keeps off the centerline: RMS distance as a part of the lumen's median radius. Explorations
#: of their own kidney, whole or half, come to 0.5 to 1.2, halves laid into another kidney to 2.7 and more.
_MOST_OFF = 1.8
#: What the rule "the tip keeps to the middle" is wrong by, as a part of the lumen's median radius, where the camera's
#: place is known and where it is not (`python -m benchmarks.registration`).
_SYSTEMATIC, _SYSTEMATIC_ALONE = 0.75, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _PathMisfit:
    """Cost of poses on a path: in mm over sigmas, so that differences read as log-likelihoods.

    Attributes:
        field: of the lumen.
        branches: tree over the centerline's nodes; heading: (C, 3) their directions away from the pelvis.
        position, axis: (N, 3) samples, EM frame.
        ahead_mm: places on the axis that must be inside: 0 is the sensor.
        inside_only: leave out the cues that need a good pose already: middle and heading.
    """

    field: DistanceField
    branches: cKDTree
    heading: Tensor
    position: Tensor
    axis: Tensor
    ahead_mm: tuple[float, ...]
    inside_only: bool = False

    def __call__(self, poses: Poses, weights: Tensor) -> Misfit:
        found = Misfit.zero(weights)
        sensor, axis = poses.apply(self.position), self.axis @ poses.R.mT
        for ahead in self.ahead_mm:
            at = sensor + ahead * axis
            wall, normal = self.field.sample(at)
            arm = at - poses.t[:, None]
            found.add_distances(arm, (wall + _NOISE_MM).clamp(min=0), normal, _WALL_MM, _SOFT_MM)
            if not self.inside_only:
                found.add_distances(arm, wall + self.field.deepest_mm, normal, _MIDDLE_MM, _MIDDLE_MM)
        if not self.inside_only:
            branch = self.heading[self.branches.query(sensor.numpy())[1]]
            found.add_directions(axis, branch, _HEADING_RAD, _HEADING_PART)
        return found


def register_centerline(
    position_mm: ArrayLike,
    axis: ArrayLike,
    mesh: trimesh.Trimesh,
    centerline: Centerline,
    *,
    sensor_offset_mm: ArrayLike | None = None,
    max_error_mm: float = 5.0,
) -> Registration:
    """Transform from the EM to the kidney frame from the path of the tip alone, without a starting guess.

    ``fre_mm`` of the result are the distances of the averaged samples from the centerline, ``report`` says how well the
    path fits and how well it determines the answer; the covariance is a jackknife's, with the error of the rule that
    the tip keeps to the middle added.

    Args:
        position_mm: (N, 3) positions of the sensor, EM frame, in order of time; rows with NaN are passed over.
        axis: (N, 3) its axes, pointing forward.
        mesh: the closed lumen, kidney frame.
        centerline: of the lumen, rooted in the pelvis.
        sensor_offset_mm: (3,) the sensor in the camera frame, where known: the camera's place on the axis must then
            be inside the lumen too.
        max_error_mm: refuse a registration whose expected error over the kidney is larger.

    Raises:
        ShapeError: positions and axes are not (N, 3).
        InputError: no axis, or far too large for the kidney.
        RegistrationError: the path is too short, does not fit the kidney, or does not determine the answer.
    """
    position, direction = _average(*_check(position_mm, axis, mesh), _STEP_MM)
    ahead = (0.0,) if sensor_offset_mm is None else (0.0, -float(np.asarray(sensor_offset_mm, float)[2]))
    field = DistanceField.from_mesh(mesh)
    solution = solve(_problem(position, direction, field, centerline, ahead))
    registration = _registration(solution, position, direction, field, centerline, ahead)
    _refuse_unless_inside(registration, float(np.median(centerline.radius_mm)))
    tre = float(np.sqrt(np.mean(registration.tre_mm(centerline.points_mm) ** 2)))
    refuse_unless_determined(solution, tre, max_error_mm, "path's samples")
    mirrored = _problem(position * [-1, 1, 1], direction * [-1, 1, 1], field, centerline, ahead)
    refuse_if_mirrored_fits(solution, mirrored, "path's samples")
    return registration


def branch_directions(centerline: Centerline, span_mm: float = 4.0) -> Array:
    """(C, 3) direction in which the branch leads away from the root at each node, over its last ``span_mm``."""
    points, parent = centerline.points_mm, centerline.parent
    before = parent.copy()
    for node in range(len(points)):
        back = node
        while parent[back] >= 0 and np.linalg.norm(points[node] - points[back]) < span_mm:
            back = parent[back]
        before[node] = back
    way = points - points[before]
    way[before == np.arange(len(points))] = points[1] - points[0]
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _check(position_mm: ArrayLike, axis: ArrayLike, mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    p, d = np.asarray(position_mm, float), np.asarray(axis, float)
    if p.ndim != 2 or p.shape[-1] != 3 or p.shape != d.shape:
        raise ShapeError(f"Expected positions and axes (N, 3), got {p.shape} and {d.shape}.")
    if not np.isfinite(d).any():
        raise InputError("The path has no axes; the columns dx, dy, dz of the sensor's direction are needed.")
    keep = np.isfinite(np.c_[p, d]).all(axis=1)
    spread, size = float(np.linalg.norm(np.ptp(p[keep], axis=0))), float(np.linalg.norm(mesh.extents))
    if not 0.02 * size < spread < 3 * size:
        raise InputError(
            f"The path spans {spread:.3g} mm and the lumen {size:.3g} mm. Check the units (both mm) and that the path "
            "holds only what was recorded inside the kidney."
        )
    return p[keep], d[keep]


def _average(position: Array, axis: Array, step_mm: float) -> tuple[Array, Array]:
    """Means of runs of samples within ``step_mm`` of the run's first: standing still must not outweigh moving."""
    run = np.zeros(len(position), int)
    first = 0
    for i in range(1, len(position)):
        if np.linalg.norm(position[i] - position[first]) > step_mm:
            first = i
        run[i] = run[i - 1] + (first == i)
    count = np.bincount(run, minlength=1)
    if len(count) < _LEAST_SAMPLES:
        raise RegistrationError(
            f"The path is too short: its {len(position)} visible samples make {len(count)} steps of {step_mm:g} mm, at "
            f"least {_LEAST_SAMPLES} are needed. Explore the kidney, into several calyces, while recording."
        )
    mean_p, mean_d = np.zeros((2, len(count), 3))
    np.add.at(mean_p, run, position)
    np.add.at(mean_d, run, axis)
    length = np.linalg.norm(mean_d, axis=1, keepdims=True)
    return mean_p / count[:, None], mean_d / np.maximum(length, 1e-9)


def _problem(
    position: Array, axis: Array, field: DistanceField, centerline: Centerline, ahead: tuple[float, ...]
) -> Problem:
    branches, heading = cKDTree(centerline.points_mm), as_tensor(branch_directions(centerline))
    p, d = as_tensor(position), as_tensor(axis)
    few = torch.linspace(0, len(p) - 1, min(len(p), _COARSE_SAMPLES)).long()
    return Problem(
        samples=p,
        part=torch.arange(len(p)) * PARTS // len(p),
        misfit=_PathMisfit(field, branches, heading, p, d, ahead),
        coarse_samples=torch.cat([p[few] + a * d[few] for a in ahead]),
        coarse_misfit=_PathMisfit(field, branches, heading, p[few], d[few], ahead, inside_only=True),
        coarse_count=len(few),
        search_cost=lambda at: (field.rough(at) + 0.5).clamp(0, 5),
        anchors_mm=as_tensor(_thinned(centerline.points_mm, _ANCHOR_MM)),
    )


def _thinned(points: Array, apart_mm: float) -> Array:
    kept = [points[0]]
    for point in points:
        if np.min(np.linalg.norm(np.array(kept) - point, axis=1)) >= apart_mm:
            kept.append(point)
    return np.array(kept)


def _registration(
    solution: Solution,
    position: Array,
    axis: Array,
    field: DistanceField,
    centerline: Centerline,
    ahead: tuple[float, ...],
) -> Registration:
    sensor, axis = position @ solution.R.T + solution.t_mm, axis @ solution.R.T
    wall = np.stack([field.sample(as_tensor(sensor + a * axis))[0].numpy() for a in ahead])
    distance, node = cKDTree(centerline.points_mm).query(sensor)
    heading = angle_between(branch_directions(centerline)[node], axis)
    systematic = (_SYSTEMATIC if len(ahead) > 1 else _SYSTEMATIC_ALONE) * np.median(centerline.radius_mm)
    return Registration(
        R=solution.R,
        t_mm=solution.t_mm,
        scale=1.0,
        n=len(sensor),
        fre_mm=distance,
        fre_rmse_mm=float(np.sqrt(np.mean(distance**2))),
        tre_loo_mm=np.zeros(0),
        tre_loo_rmse_mm=None,
        used=np.ones(len(sensor), bool),
        center_mm=solution.center_mm,
        covariance=solution.covariance + np.diag([0, 0, 0, *[systematic**2 / 3] * 3]),
        method="centerline",
        report={
            "outside": float(np.mean(wall.max(axis=0) > 1.0)),
            "heading_deg": float(np.degrees(np.median(heading))),
            "gap": min(solution.gap, 1e6),
            "rival_mm": solution.rival_mm,
        },
    )


def _refuse_unless_inside(registration: Registration, radius_mm: float) -> None:
    assert registration.report is not None
    outside, heading = registration.report["outside"], registration.report["heading_deg"]
    if outside > _MOST_OUTSIDE:
        raise RegistrationError(
            f"The path does not fit this kidney: in its best place {outside:.0%} of it lie more than 1 mm outside the "
            f"lumen ({_MOST_OUTSIDE:.0%} are accepted). Check side, scale, units (mm) and handedness, and that the "
            "path holds only what was recorded inside the kidney."
        )
    if registration.fre_rmse_mm > _MOST_OFF * radius_mm:
        raise RegistrationError(
            f"The path does not fit this kidney: in its best place it keeps {registration.fre_rmse_mm:.1f} mm RMS off "
            f"the centerline of a lumen of {radius_mm:.1f} mm radius ({_MOST_OFF * radius_mm:.1f} mm are accepted). Is "
            "it another kidney's? Else explore more calyces, or touch landmarks."
        )
    if heading > 90:
        raise RegistrationError(
            f"The sensor's axis points back along the branches (median angle {heading:.0f} degrees). Change the sign "
            "of dx, dy, dz if they point towards the shaft instead of out of the tip."
        )
