"""Distances along the lumen, clearance from the wall, and the calyx that a camera observes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import dijkstra

from ursnav_torch.errors import ShapeError
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.grid import LumenGrid

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Voxel for distances along the lumen, mm at scale 1.
VOXEL_MM = 0.5
#: A calyx is observed from within this distance along the lumen, mm at scale 1.
OBSERVED_WITHIN_MM = 14.0


@dataclass(frozen=True, slots=True)
class LumenDistance:
    """Distance along the lumen to every calyx tip.

    Shortest paths over voxels turn at angles of 45 degrees at least and come out up to 13 % long, so every path is pulled
    tight: each voxel keeps its *corner*, the farthest voxel towards the tip that it sees in a straight line. Distances
    are exact to about a voxel where the way bends and to rounding where it is straight.

    Attributes:
        grid: the voxels of the lumen.
        corner_mm: (C, V, 3) where the straight first part of the way to tip c from voxel v ends.
        beyond_mm: (C, V) length of the rest of that way.
        scale: the kidney's scale.
    """

    grid: LumenGrid
    corner_mm: Array
    beyond_mm: Array
    scale: float

    @classmethod
    def from_kidney(cls, kidney: Kidney, voxel_mm: float | None = None) -> "LumenDistance":
        """Distances for a kidney on voxels of ``voxel_mm`` (0.5 mm at scale 1 by default)."""
        grid = LumenGrid.from_mesh(kidney.mesh, voxel_mm or VOXEL_MM * kidney.scale)
        seeds = grid.nearest(kidney.tips_mm)
        lengths, towards = dijkstra(grid.graph(), indices=seeds, return_predecessors=True)
        ways = [_pull_tight(grid, *way) for way in zip(seeds, lengths, towards, strict=True)]
        corner = np.stack([grid.centers_mm[corner] for corner, _ in ways])
        beyond = np.stack([length[corner] for corner, length in ways])
        for c, (tip, seed) in enumerate(zip(kidney.tips_mm, seeds, strict=True)):
            corner[c, ways[c][0] == seed] = tip
        return cls(grid, corner, beyond, kidney.scale)

    def to_calyces(self, points_mm: ArrayLike) -> Array:
        """(N, C) distance in mm along the lumen from points (N, 3), kidney frame, to each calyx tip.

        A point outside the lumen is taken from the nearest voxel inside.
        """
        points = np.asarray(points_mm, float).reshape(-1, 3)
        voxel = self.grid.nearest(points)
        straight = np.linalg.norm(points[None] - self.corner_mm[:, voxel], axis=-1)
        return (straight + self.beyond_mm[:, voxel]).T

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


def _pull_tight(grid: LumenGrid, seed: int, length: Array, towards: IntArray) -> tuple[IntArray, Array]:
    """Corner (V,) of every voxel and its length (V,) of way to the seed, from voxel paths ``length`` and ``towards``.

    Theta* on a fixed tree (Nash et al., AAAI 2007), one generation of voxels after the other: a voxel that sees the
    corner of the voxel before it takes that corner, else that voxel is its corner.
    """
    corner, length = np.full(len(towards), seed), length.copy()
    for voxels in _generations(towards):
        before = towards[voxels]
        ahead = corner[before]
        sees = _sees(grid, grid.centers_mm[voxels], grid.centers_mm[ahead])
        corner[voxels] = np.where(sees, ahead, before)
        step = grid.centers_mm[voxels] - grid.centers_mm[corner[voxels]]
        length[voxels] = length[corner[voxels]] + np.linalg.norm(step, axis=1)
    return corner, length


def _generations(towards: IntArray) -> list[IntArray]:
    """Nodes by their number of steps to the root, from 1 on; ``towards`` (V,) is negative at roots and loners."""
    root = towards < 0
    steps, ahead = np.where(root, 0, 1), np.where(root, np.arange(len(towards)), towards)
    while steps[ahead].any():
        steps, ahead = steps + steps[ahead], ahead[ahead]
    order = np.argsort(steps, kind="stable")
    return np.split(order, np.searchsorted(steps[order], np.arange(1, steps.max() + 1)))[1:]


def _sees(grid: LumenGrid, a_mm: Array, b_mm: Array) -> NDArray[np.bool_]:
    """(K,) whether the straight line between points (K, 3) inside the lumen stays inside."""
    steps = np.ceil(np.linalg.norm(b_mm - a_mm, axis=1) / grid.voxel_mm * 1.5).astype(int)
    pair = np.repeat(np.arange(len(a_mm)), steps)
    k = np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)
    fraction = ((k + 0.5) / np.repeat(steps, steps))[:, None]
    at = a_mm[pair] + fraction * (b_mm[pair] - a_mm[pair])
    voxel = np.rint((at - grid.origin_mm) / grid.voxel_mm).astype(int)
    blocked = grid.index[tuple(voxel.T)] < 0
    return np.bincount(pair[blocked], minlength=len(a_mm)) == 0
