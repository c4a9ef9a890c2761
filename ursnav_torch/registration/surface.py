"""Registration from points touched on the inner surface, without knowing which point is where."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import Array, apply, transform_from
from ursnav_torch.registration.field import DistanceField
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
    points_em: ArrayLike, mesh: trimesh.Trimesh, *, trim: float = 0.9, max_error_mm: float = 5.0
) -> Registration:
    """Transform from the EM to the kidney frame from touched points, without partners and without a starting guess.

    All rotations are searched on the distance field; the best answer is then polished against the triangles by
    point-to-plane ICP (Chen and Medioni 1992), trimmed (Chetverikov et al. 2002).

    Args:
        points_em: (N, 3) points on the surface, EM frame, mm; rows with NaN are passed over.
        mesh: the closed surface that was touched, kidney frame.
        trim: part of the points, the nearest ones, that the polish uses.
        max_error_mm: refuse a registration whose expected error over the kidney is larger.

    Raises:
        ShapeError: the points are not (N, 3).
        InputError: ``trim`` is out of range, or the points are far too large or small for the kidney.
        RegistrationError: too few points, or they do not fit the kidney or leave the answer open.
    """
    points = _check(points_em, mesh, trim)
    field = DistanceField.from_mesh(mesh)
    solution = solve(_problem(points, field, mesh))
    T, distance, used = _polish(solution, points, mesh, trim)
    registration = _registration(T, distance, used, solution)
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


def _check(points_em: ArrayLike, mesh: trimesh.Trimesh, trim: float) -> Array:
    points = np.asarray(points_em, float)
    if points.ndim != 2 or points.shape[-1] != 3:
        raise ShapeError(f"Expected points (N, 3), got {points.shape}.")
    if not 0.3 <= trim <= 1:
        raise InputError(f"trim={trim} must lie between 0.3 and 1: the part of the points that is used.")
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _LEAST_POINTS:
        raise RegistrationError(
            f"{len(points)} touched points are too few to find their place on the surface; at least {_LEAST_POINTS}, "
            "better 50, are needed, on all sides. With fewer, touch landmarks whose place is known."
        )
    ratio = np.linalg.norm(np.ptp(points, axis=0)) / np.linalg.norm(mesh.extents)
    if not 0.02 < ratio < 3:
        raise InputError(f"The points span {ratio:.3g} times the kidney's surface. Check the units; both must be mm.")
    return points


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


def _registration(T: Array, distance: Array, used: BoolArray, solution: Solution) -> Registration:
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
        report={"gap": min(solution.gap, 1e6), "rival_mm": solution.rival_mm},
    )
