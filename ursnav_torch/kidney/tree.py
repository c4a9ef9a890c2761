"""The centerline: a tree along the middle of the lumen from the pelvis to every calyx tip."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Centerline
from ursnav_torch.kidney.grid import LumenGrid

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Rounds of smoothing; each moves a node half-way to the middle of its neighbors.
_ROUNDS = 30


def central_paths(grid: LumenGrid, root: int) -> IntArray:
    """(V,) next voxel from every voxel towards ``root``, on the way that keeps to the middle of the lumen.

    A step costs its length over the square of the radius there, so that paths run along the ridge of the distance
    to the wall, as in TEASAR (Sato et al., Pacific Graphics 2000).
    """
    steps = grid.graph.tocoo()
    radius = grid.radius_mm
    middle = (radius[steps.row] + radius[steps.col]) / 2
    cost = csr_array((steps.data / np.maximum(middle, 1e-3) ** 2, (steps.row, steps.col)), shape=steps.shape)
    return dijkstra(cost, indices=root, return_predecessors=True)[1]


def grow_tree(grid: LumenGrid, pelvis_mm: ArrayLike, tips_mm: ArrayLike) -> Centerline:
    """The centerline from the ridge near ``pelvis_mm`` (3,) to the tips (C, 3), ending exactly at each tip.

    Raises:
        InputError: the lumen has no way from the pelvis to a tip.
    """
    tips = np.asarray(tips_mm, float).reshape(-1, 3)
    root = ridge_near(grid, pelvis_mm)
    towards = central_paths(grid, root)
    seeds = grid.nearest(tips)
    parent, voxel, calyx = _join(root, seeds, towards)
    points = grid.centers_mm[voxel]
    for c, (tip, seed) in enumerate(zip(tips, seeds, strict=True)):
        end = int(np.flatnonzero(voxel == seed)[0])
        if end > 0 and calyx[end] == c and not np.any(parent == end):
            points[end] = tip
        else:  # the way to another tip passes here
            points, parent, calyx = np.vstack([points, tip]), np.append(parent, end), np.append(calyx, c)
    points = _smooth(grid, points, parent)
    return Centerline(points, np.maximum(grid.clearance_mm(points), 0.0), parent, calyx)


def ridge_near(grid: LumenGrid, point_mm: ArrayLike) -> int:
    """The voxel reached from a point (3,) by climbing to ever larger distance from the wall."""
    radius, graph = grid.radius_mm, grid.graph
    voxel = int(grid.nearest(point_mm)[0])
    while True:
        around = graph.indices[graph.indptr[voxel] : graph.indptr[voxel + 1]]
        best = int(around[radius[around].argmax()])
        if radius[best] <= radius[voxel]:
            return voxel
        voxel = best


def _join(root: int, seeds: IntArray, towards: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Parent, voxel and calyx (-1 where shared) of the union of the paths from the seeds to the root."""
    node = {root: 0}
    parent, calyx = [-1], [-1]
    for c, seed in enumerate(seeds):
        way = [int(seed)]
        while way[-1] not in node:
            if towards[way[-1]] < 0:
                raise InputError(
                    f"No way through the lumen leads from the pelvis to calyx number {c + 1}: a neck between them is "
                    "closed. Check the point and the mesh there."
                )
            way.append(int(towards[way[-1]]))
        shared = node[way.pop()]
        while shared >= 0:
            calyx[shared] = -1
            shared = parent[shared]
        for voxel in way[::-1]:
            parent.append(node[int(towards[voxel])])
            calyx.append(c)
            node[voxel] = len(calyx) - 1
    return np.array(parent), np.array(list(node)), np.array(calyx)


def _smooth(grid: LumenGrid, points: Array, parent: IntArray) -> Array:
    """Nodes moved towards the middle of their neighbors; root and tips stay, and no node nears the wall by a third."""
    child = np.arange(1, len(points))
    links = csr_array((np.ones(len(child)), (child, parent[1:])), shape=(len(points),) * 2)
    links = (links + links.T).tocsr()
    degree = links.sum(axis=1)
    free = degree > 1
    free[0] = False
    floor = grid.clearance_mm(points) * 2 / 3
    for _ in range(_ROUNDS):
        moved = np.where(free[:, None], (points + links @ points / degree[:, None]) / 2, points)
        points = np.where((grid.clearance_mm(moved) >= floor)[:, None], moved, points)
    return points
