"""Registration from points touched on the inner surface, without knowing which point is where."""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import Array, apply, transform_from
from ursnav_torch.registration.field import DistanceField
from ursnav_torch.registration.landmarks import RegistrationWarning
from ursnav_torch.registration.result import Registration, skew
from ursnav_torch.registration.search import Misfit, Poses, as_tensor
from ursnav_torch.registration.solve import (
    PARTS,
    Problem,
    Solution,
    refuse_if_mirrored_fits,
    refuse_unless_determined,
    solve,
)

BoolArray = NDArray[np.bool_]

#: Six unknowns and a few points to check them by.
_LEAST_POINTS = 12
_COARSE_POINTS, _ANCHORS = 80, 100
#: Points farther than this from the surface pull only with constant force, mm.
_SOFT_MM = 1.5
#: Expected distance of a touch from the surface, mm: the sensor's noise and the wall that gives way.
_TOUCH_MM = 1.0
#: Touches point at the wall: of axes that lie within about 25 degrees of it the set is a path.
_LEAST_ONTO = 0.42
#: Steps of a path, as a part of the distance between points half a set apart.
_PATH_STEP = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class _SurfaceMisfit:
    """Huber's cost of the distance of points (N, 3), EM frame, from the surface."""

    field: DistanceField
    points: Tensor

    def __call__(self, poses: Poses, weights: Tensor) -> Misfit:
        found, at = Misfit.zero(weights), poses.apply(self.points)
        distance, normal = self.field.sample(at)
        found.add_distances(at - poses.t[:, None], distance, normal, _TOUCH_MM, _SOFT_MM)
        return found


def register_surface(
    points_em: ArrayLike,
    mesh: trimesh.Trimesh,
    *,
    axis_em: ArrayLike | None = None,
    trim: float = 0.9,
    max_error_mm: float = 5.0,
) -> Registration:
    """Transform from the EM to the kidney frame from touched points, without partners and without a starting guess.

    All rotations are searched on the distance field; the best answer is then polished against the triangles by
    point-to-plane ICP (Chen and Medioni 1992), trimmed (Chetverikov et al. 2002).

    The path of a scope through the lumen can be laid onto the wall too, and wrongly; a set that looks like one is
    refused where its axes say so, and is said to be suspicious where only its order does.

    Args:
        points_em: (N, 3) points on the surface, EM frame, mm; rows with NaN are passed over.
        mesh: the closed surface that was touched, kidney frame.
        axis_em: (N, 3) the sensor's axes where known, which point at what is touched; rows with NaN say nothing.
        trim: part of the points, the nearest ones, that the polish uses.
        max_error_mm: refuse a registration whose expected error over the kidney is larger.

    Raises:
        ShapeError: the points are not (N, 3), or the axes are not as many.
        InputError: ``trim`` is out of range, or the points are far too large or small for the kidney.
        RegistrationError: too few points, or they do not fit the kidney or leave the answer open, or are no touches.
    """
    points, axis = _check(points_em, axis_em, mesh, trim)
    field = DistanceField.from_mesh(mesh)
    solution = solve(_problem(points, field, mesh))
    T, distance, used = _polish(solution, points, mesh, trim)
    registration = _registration(T, distance, used, solution, _path_suspicion(points, axis))
    for sentence in registration.suspicions:
        warnings.warn(sentence, RegistrationWarning, stacklevel=2)
    _refuse_path(apply(T, points), registration.apply_direction(axis), mesh)
    if registration.fre_rmse_mm > 3 * _TOUCH_MM:
        raise RegistrationError(
            f"The touched points do not fit this kidney: the nearest {trim:.0%} of them stay "
            f"{registration.fre_rmse_mm:.1f} mm RMS off its surface ({3 * _TOUCH_MM:g} mm are accepted). "
            "Check side, scale and units (mm)."
        )
    tre = float(np.sqrt(np.mean(registration.tre_mm(mesh.vertices) ** 2)))
    refuse_unless_determined(solution, tre, max_error_mm, "touched points")
    refuse_if_mirrored_fits(solution, _problem(points * [-1, 1, 1], field, mesh), "touched points")
    return registration


def _check(points_em: ArrayLike, axis_em: ArrayLike | None, mesh: trimesh.Trimesh, trim: float) -> tuple[Array, Array]:
    points = np.asarray(points_em, float)
    axis = np.full(points.shape, np.nan) if axis_em is None else np.asarray(axis_em, float)
    if axis.shape != points.shape:
        raise ShapeError(f"Expected as many axes as points, got {axis.shape} and {points.shape}.")
    if points.ndim != 2 or points.shape[-1] != 3:
        raise ShapeError(f"Expected points (N, 3), got {points.shape}.")
    if not 0.3 <= trim <= 1:
        raise InputError(f"trim={trim} must lie between 0.3 and 1: the part of the points that is used.")
    visible = np.isfinite(points).all(axis=1)
    points, axis = points[visible], axis[visible]
    if len(points) < _LEAST_POINTS:
        raise RegistrationError(
            f"{len(points)} touched points are too few to find their place on the surface; at least {_LEAST_POINTS}, "
            "better 50, are needed, on all sides. With fewer, touch landmarks whose place is known."
        )
    ratio = np.linalg.norm(np.ptp(points, axis=0)) / np.linalg.norm(mesh.extents)
    if not 0.02 < ratio < 3:
        raise InputError(f"The points span {ratio:.3g} times the kidney's surface. Check the units; both must be mm.")
    return points, axis


def _path_suspicion(points: Array, axis: Array) -> tuple[str, ...]:
    """What the order of points (N, 3) without axes says: a path goes on in steps, a hand touches here and there."""
    step = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    apart = float(np.median(np.linalg.norm(points - np.roll(points, len(points) // 2, axis=0), axis=1)))
    if np.isfinite(axis).any() or step > _PATH_STEP * apart:
        return ()
    return (
        f"The points follow each other in steps of {step:.1f} mm (median) over {apart:.0f} mm, as on a scope's way "
        "through the lumen, not here and there on its wall. If it is a path, take registration=centerline, with the "
        "columns dx,dy,dz.",
    )


def _refuse_path(points: Array, axis: Array, mesh: trimesh.Trimesh) -> None:
    """Refuse points (N, 3) whose axes (N, 3), both in the kidney frame, run along the wall instead of at it."""
    known = np.isfinite(axis).all(axis=1)
    if not known.any():
        return
    _, _, face = trimesh.proximity.closest_point(mesh, points[known])
    onto = np.abs(np.sum(axis[known] * mesh.face_normals[face], axis=1)) / np.linalg.norm(axis[known], axis=1)
    if np.median(onto) < _LEAST_ONTO:
        angle = np.degrees(np.arcsin(np.median(onto)))
        raise RegistrationError(
            f"The sensor's axis runs along the wall (median angle {angle:.0f} degrees), as on a scope's way through "
            "the lumen. For a path take registration=centerline; where points were touched with the side of the "
            "sensor, leave the columns dx,dy,dz out."
        )


def _problem(points: Array, field: DistanceField, mesh: trimesh.Trimesh) -> Problem:
    p = as_tensor(points)
    few = p[torch.linspace(0, len(p) - 1, min(len(p), _COARSE_POINTS)).long()]
    surface, _ = trimesh.sample.sample_surface_even(mesh, _ANCHORS, seed=0)
    return Problem(
        samples=p,
        part=torch.arange(len(p)) % PARTS,
        misfit=_SurfaceMisfit(field, p),
        coarse_samples=few,
        coarse_misfit=_SurfaceMisfit(field, few),
        coarse_count=len(few),
        search_cost=lambda at: field.rough(at).abs().clamp(0, 5),
        anchors_mm=as_tensor(surface),
    )


def _polish(solution: Solution, points: Array, mesh: trimesh.Trimesh, trim: float) -> tuple[Array, Array, BoolArray]:
    """``T_kidney_em``, distances (N,) to the triangles and which points were used, after ICP from the solution."""
    T = transform_from(solution.R, solution.t_mm)
    for _ in range(30):
        at = apply(T, points)
        nearest, distance, face = trimesh.proximity.closest_point(mesh, at)
        used = distance <= np.quantile(distance, trim)
        step = _plane_step(at[used], nearest[used], mesh.face_normals[face[used]])
        T = step @ T
        if np.abs(step - np.eye(4)).max() < 1e-6:
            break
    _, distance, _ = trimesh.proximity.closest_point(mesh, apply(T, points))
    return T, distance, used


def _plane_step(at: Array, nearest: Array, normal: Array) -> Array:
    """(4, 4) small rigid step that brings points (N, 3) onto the planes at their nearest points, about their mean."""
    center = at.mean(axis=0)
    J = np.concatenate([np.cross(at - center, normal), normal], axis=1)
    away = np.sum((at - nearest) * normal, axis=1)
    step = np.linalg.lstsq(J, -away, rcond=None)[0]
    U, _, Vh = np.linalg.svd(np.eye(3) + skew(step[:3]))
    R = U @ Vh
    return transform_from(R, center + step[3:] - R @ center)


def _registration(
    T: Array, distance: Array, used: BoolArray, solution: Solution, suspicions: tuple[str, ...]
) -> Registration:
    return Registration(
        R=T[:3, :3],
        t_mm=T[:3, 3],
        scale=1.0,
        n=int(used.sum()),
        fre_mm=distance,
        fre_rmse_mm=float(np.sqrt(np.mean(distance[used] ** 2))),
        tre_loo_mm=np.zeros(0),
        tre_loo_rmse_mm=None,
        used=used,
        center_mm=solution.center_mm,
        covariance=solution.covariance,
        method="surface",
        suspicions=suspicions,
        report={"gap": min(solution.gap, 1e6), "rival_mm": solution.rival_mm},
    )
