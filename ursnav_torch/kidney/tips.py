"""The pelvis and the tips of the minor calyces, found from the shape of the lumen alone."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import csr_array, hstack, vstack
from scipy.sparse.csgraph import dijkstra

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.tree import central_paths, ridge_near

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_PROTRUSION_MM = 2.6
_APART_MM = 9.0


def find_pelvis(grid: LumenGrid, scale: float) -> Array:
    """(3,) the middle of the place with the most lumen within some 5 mm."""
    inside = (grid.index >= 0).astype(float)
    bulk = ndimage.gaussian_filter(inside, 5.0 * scale / grid.voxel_mm)[grid.index >= 0]
    return grid.centers_mm[ridge_near(grid, grid.centers_mm[bulk.argmax()])]


def find_tips(grid: LumenGrid, pelvis_mm: ArrayLike, scale: float) -> Array:
    """(C, 3) tips of the minor calyces.

    Raises:
        InputError: nothing protrudes from the pelvis.
    """
    graph, root = grid.graph(), ridge_near(grid, pelvis_mm)
    towards = central_paths(grid, root)
    beyond = dijkstra(graph, indices=root) - grid.radius_mm[root]
    beyond[~np.isfinite(beyond)] = -np.inf
    tree, tips = {root}, []
    while beyond.max() > _PROTRUSION_MM * scale:
        tip = int(beyond.argmax())
        way = [tip]
        while towards[way[-1]] not in tree:
            way.append(int(towards[way[-1]]))
        tree.update(way)
        tips.append(tip)
        beyond = np.minimum(beyond, _beyond(graph, grid.radius_mm, np.array(way)))
        near = dijkstra(graph, indices=tip, limit=_APART_MM * scale) < _APART_MM * scale
        beyond[near] = -np.inf
    if not tips:
        raise InputError("No calyx was found: nothing protrudes from the pelvis. Give kidney.calyces=FILE.")
    return grid.centers_mm[tips]


def _beyond(graph: csr_array, radius: Array, nodes: IntArray) -> Array:
    """(V,) how far every voxel lies beyond the balls inscribed at some voxels."""
    top = radius.max() + 1e-6
    start = csr_array((top - radius[nodes], (np.zeros(len(nodes), int), nodes)), shape=(1, len(radius)))
    whole = vstack([hstack([graph, csr_array((len(radius), 1))]), hstack([start, csr_array((1, 1))])]).tocsr()
    return dijkstra(whole, indices=len(radius))[:-1] - top
