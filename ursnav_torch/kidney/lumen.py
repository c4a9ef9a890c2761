"""Distances along the lumen, clearance from the wall, the calyx that a camera observes or that a place belongs to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ursnav_torch.errors import ShapeError
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.geodesic import ways_to
from ursnav_torch.kidney.grid import LumenGrid, VoxelGrid

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Voxel for distances along the lumen, mm at scale 1.
VOXEL_MM = 0.5
#: Nodes of the centerline that are asked for each place.
_NODES = 12
#: A corner that is no voxel but the tip.
AT_TIP = -1
#: A calyx is observed from within this distance along the lumen, mm at scale 1.
OBSERVED_WITHIN_MM = 14.0


@dataclass(frozen=True, slots=True, eq=False)
class LumenDistance:
    """Distance along the lumen to every calyx tip.

    Exact to about a voxel where the way bends and to rounding where it is straight.

    Attributes:
        grid: the voxels of the lumen.
        tips_mm: (C, 3) the calyces' tips.
        corner: (C, V) int32, the voxel where the straight first part of the way to tip c from voxel v ends; `AT_TIP`
            where it leads to the tip itself.
        beyond_mm: (C, V) float32, length of the rest of that way.
        scale: the kidney's scale.
    """

    grid: VoxelGrid
    tips_mm: Array
    corner: NDArray[np.int32]
    beyond_mm: NDArray[np.float32]
    scale: float

    @classmethod
    def from_kidney(cls, kidney: Kidney, voxel_mm: float | None = None) -> "LumenDistance":
        """Distances for a kidney on voxels of ``voxel_mm`` (0.5 mm at scale 1 by default)."""
        grid = LumenGrid.from_mesh(kidney.mesh, voxel_mm or VOXEL_MM * kidney.scale)
        corner, beyond = [], []
        for seed in grid.nearest(kidney.tips_mm):
            ways = ways_to(grid, np.array([seed]))
            corner.append(np.where(ways.corner == seed, AT_TIP, ways.corner).astype(np.int32))
            beyond.append(ways.length_mm[ways.corner].astype(np.float32))
        return cls(grid, kidney.tips_mm, np.stack(corner), np.stack(beyond), kidney.scale)

    def to_calyces(self, points_mm: ArrayLike) -> Array:
        """(N, C) distance in mm along the lumen from points (N, 3), kidney frame, to each calyx tip.

        A point outside the lumen is taken from the nearest voxel inside.
        """
        points = np.asarray(points_mm, float).reshape(-1, 3)
        voxel = self.grid.nearest(points)
        corner = self.corner[:, voxel]
        there = np.where((corner == AT_TIP)[..., None], self.tips_mm[:, None], self.grid.centers_mm[corner])
        return (np.linalg.norm(points - there, axis=-1) + self.beyond_mm[:, voxel]).T

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance in mm from points (N, 3), kidney frame, to the wall; negative outside the lumen."""
        return self.grid.clearance_mm(points_mm)


def observed_calyx(T_kidney_camera: ArrayLike, kidney: Kidney, lumen: LumenDistance) -> IntArray:
    """(N,) index of the calyx that each camera (N, 4, 4) observes, -1 where it observes none.

    Of the calyces whose tip lies within 14 mm (times the kidney's scale) of the camera along the lumen, the one at the
    smallest angle to the optical axis.

    Raises:
        ShapeError: the transforms are not (N, 4, 4).
    """
    T = np.asarray(T_kidney_camera, float)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise ShapeError(f"T_kidney_camera must have shape (N, 4, 4), got {T.shape}.")
    position, axis = T[:, :3, 3], T[:, :3, 2]
    angle = angle_between(kidney.tips_mm[None] - position[:, None], axis[:, None])
    near = lumen.to_calyces(position) <= OBSERVED_WITHIN_MM * kidney.scale
    best = np.where(near, angle, np.inf).argmin(axis=1)
    return np.where(near.any(axis=1), best, -1)


def branch_calyx(points_mm: Array, kidney: Kidney, lumen: LumenDistance, within_mm: float) -> IntArray:
    """(P,) index of the calyx that places in the lumen or on its wall (P, 3) belong to, -1 for none: the nearest tip
    along the lumen, where it is within ``within_mm`` and the nearest part of the centerline leads to that calyx alone.
    """
    tree = kidney.centerline
    away = np.maximum(tree.radius_mm, 1e-6)
    _, nodes = cKDTree(tree.points_mm).query(points_mm, k=min(_NODES, len(away)))
    nodes = np.asarray(nodes).reshape(len(points_mm), -1)
    relative = np.linalg.norm(points_mm[:, None] - tree.points_mm[nodes], axis=-1) / away[nodes]
    node = nodes[np.arange(len(nodes)), relative.argmin(1)]
    to_tip = lumen.to_calyces(points_mm)
    nearest = to_tip.argmin(1)
    return np.where((to_tip.min(1) <= within_mm) & (tree.calyx[node] == nearest), nearest, -1)
