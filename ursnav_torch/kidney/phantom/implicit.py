"""The surface of a planned collecting system: one implicit function on a grid, then marching cubes."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from ursnav_torch.kidney.phantom.shapes import Cup, PhantomPlan, Tube

Array = NDArray[np.float64]

_VOXEL_MM = 0.5
_MARGIN_MM = 7.0
#: Unevenness of the wall: standard deviation and width of bumps, mm; and how far they may narrow and widen the lumen.
_BUMPS_MM = ((0.45, 4.5), (0.22, 2.0), (0.05, 0.7))
_NARROWED_MM, _WIDENED_MM = 0.45, 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Signed distance-like values (X, Y, Z), negative in the lumen, on a grid that starts at ``origin_mm`` (3,)."""

    values: Array
    origin_mm: Array

    def box(self, points_mm: Array, margin_mm: float) -> tuple[tuple[slice, ...], Array]:
        """Slices of the grid around points (K, 3), and the nodes (..., 3) there, in mm."""
        low = np.maximum((points_mm.min(axis=0) - margin_mm - self.origin_mm) / _VOXEL_MM, 0).astype(int)
        high = ((points_mm.max(axis=0) + margin_mm - self.origin_mm) / _VOXEL_MM + 2).astype(int)
        slices = tuple(slice(a, b) for a, b in zip(low, np.minimum(high, self.values.shape), strict=True))
        nodes = np.stack(np.meshgrid(*(np.arange(s.start, s.stop) for s in slices), indexing="ij"), axis=-1)
        return slices, self.origin_mm + _VOXEL_MM * nodes

    def join(self, slices: tuple[slice, ...], values: Array, blend_mm: float) -> None:
        """Unite with other values, rounded off over ``blend_mm``."""
        self.values[slices] = _smooth_min(self.values[slices], values, blend_mm)


def plan_surface(plan: PhantomPlan, rng: np.random.Generator) -> trimesh.Trimesh:
    """The closed lumen surface of a plan, mm, normals outward; with handles where branches touch."""
    field = _empty_field(plan)
    _add_pelvis(field, plan.pelvis_mm)
    for tube in plan.tubes:
        _add_tube(field, tube)
    for cup in plan.cups:
        _add_cup(field, cup)
    field = Field(field.values + _bumps(field.values.shape, rng), field.origin_mm)
    _cut(field, plan.ureter)
    return _mesh(field)


def _mesh(field: Field) -> trimesh.Trimesh:
    values = ndimage.gaussian_filter(field.values, 0.35 / _VOXEL_MM)
    labels = ndimage.label(values < 0)[0]
    largest = np.bincount(labels.ravel())[1:].argmax() + 1
    values = np.where((values < 0) & (labels != largest), 0.1, values)
    vertices, faces, *_ = marching_cubes(values, 0.0, spacing=(_VOXEL_MM,) * 3)
    mesh = trimesh.Trimesh(vertices + field.origin_mm, faces, process=True)
    trimesh.smoothing.filter_taubin(mesh, lamb=0.5, nu=0.53, iterations=6)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _empty_field(plan: PhantomPlan) -> Field:
    points = [t.points_mm for t in plan.tubes] + [np.stack([c.base_mm, c.end_mm]) for c in plan.cups]
    points += [np.diag(plan.pelvis_mm), -np.diag(plan.pelvis_mm)]
    low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
    shape = np.ceil((high - low + 2 * _MARGIN_MM) / _VOXEL_MM).astype(int) + 1
    return Field(np.full(shape, 20.0), low - _MARGIN_MM)


def _add_pelvis(field: Field, half: Array) -> None:
    slices, nodes = field.box(np.stack([-half, half]), 4.0)
    relative = np.linalg.norm(nodes / half, axis=-1)
    steep = np.linalg.norm(nodes / half**2, axis=-1)
    field.join(slices, relative * (relative - 1) / np.maximum(steep, 1e-6), 1.0)


def _add_tube(field: Field, tube: Tube) -> None:
    slices, nodes = field.box(tube.points_mm, tube.radius_mm.max() * 1.3 + 2.5)
    shape, nodes = nodes.shape[:-1], nodes.reshape(-1, 3)
    distance, k = cKDTree(tube.points_mm).query(nodes)
    side, up = _frames(tube.points_mm)
    off = nodes - tube.points_mm[k]
    angle = np.arctan2(np.sum(off * up[k], axis=1), np.sum(off * side[k], axis=1))
    radius = tube.radius_mm[k] * tube.outline.at(angle + tube.twist * k / len(tube.points_mm))
    field.join(slices, (distance - radius).reshape(shape), 1.6)


def _frames(line: Array) -> tuple[Array, Array]:
    """Two unit vectors (K, 3) across a curve (K, 3), turning as little as the curve allows."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.zeros_like(line)
    before = np.eye(3)[np.abs(tangent[0]).argmin()]
    for i, along in enumerate(tangent):
        across = before - along * (before @ along)
        before = side[i] = across / np.linalg.norm(across)
    return side, np.cross(tangent, side)


def _add_cup(field: Field, cup: Cup) -> None:
    slices, nodes = field.box(np.stack([cup.base_mm, cup.end_mm]), cup.radii_mm.max() * 1.2 + 3.0)
    local = cup.local(nodes)
    mean = float(np.sqrt(cup.radii_mm.prod()))
    relative = local[..., :2] / cup.radii_mm
    round_ = cup.outline.at(np.arctan2(relative[..., 1], relative[..., 0]))
    lumen = _bowl(np.linalg.norm(relative, axis=-1) * mean / round_, local[..., 2], cup.neck_mm, mean, cup.depth_mm)
    for papilla in cup.papillae:
        off = local[..., :2] - papilla.at_mm
        out = np.linalg.norm(off, axis=-1) / papilla.foot_mm
        surface = cup.depth_mm + 0.3 + off @ papilla.tilt - papilla.height_mm * (1 - out**2)
        slope = np.hypot(1, 2 * papilla.height_mm * np.minimum(out, 1) / papilla.foot_mm)
        lumen = -_smooth_min(-lumen, (surface - local[..., 2]) / slope, 0.7)
    field.join(slices, lumen, 0.9)


def _bowl(across: Array, along: Array, neck: float, wide: float, depth: float) -> Array:
    """Distance-like values of a bowl: ``neck`` wide at 0, ``wide`` from 0.6 of its depth on, its rim rounded."""
    rim = 0.8
    opening = neck + (wide - neck) * np.clip(along / (0.6 * depth), 0, 1) ** 0.8
    outside = np.stack([across - (opening - rim), along - (depth - rim), -along - rim], axis=-1)
    return np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(axis=-1), 0) - rim


def _cut(field: Field, tube: Tube) -> None:
    """End a tube in a plane across it."""
    end, before = tube.points_mm[-1], tube.points_mm[-4]
    slices, nodes = field.box(end[None], 2.5 * tube.radius_mm[-1])
    beyond = (nodes - end) @ (end - before) / np.linalg.norm(end - before)
    field.values[slices] = np.maximum(field.values[slices], beyond)


def _bumps(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(X, Y, Z) unevenness in mm, positive where it narrows the lumen."""
    total = np.zeros(shape)
    for height, width in _BUMPS_MM:
        noise = ndimage.gaussian_filter(rng.standard_normal(shape), width / _VOXEL_MM)
        total += noise * height / noise.std()
    return np.clip(total, -_WIDENED_MM, _NARROWED_MM)


def _smooth_min(a: Array, b: Array, blend_mm: float) -> Array:
    """The smaller of two fields, rounded off where they differ by less than ``blend_mm`` (I. Quilez' polynomial)."""
    h = np.maximum(blend_mm - np.abs(a - b), 0) / blend_mm
    return np.minimum(a, b) - h * h * blend_mm / 4
