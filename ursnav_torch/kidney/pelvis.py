"""The middle of the renal pelvis and the ureter that leaves it, found from the shape of the lumen."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.tree import ridge_near

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Width of the neighborhood in which the pelvis holds the most lumen, mm at scale 1.
_AROUND_MM = 5.0
#: The ureter runs to the midline (cosine) and is slender (spread across of its last 7 mm, mm at scale 1).
_MEDIAL, _END_MM, _SLENDER_MM = -0.3, 7.0, 1.35


def find_pelvis(grid: LumenGrid, scale: float) -> Array:
    """(3,) the middle of the pelvis: much lumen around, and no end of the lumen far away.

    The measure is the volume in a Gaussian neighborhood over the way to the farthest end.
    """
    inside = grid.index >= 0
    bulk = ndimage.gaussian_filter(inside.astype(float), _AROUND_MM * scale / grid.voxel_mm)[inside]
    one = _farthest(grid.graph, int(bulk.argmax()))
    way = dijkstra(grid.graph, indices=[one, _farthest(grid.graph, one)]).max(axis=0)
    best = int(np.where(np.isfinite(way), bulk / np.maximum(way, 1e-6), 0).argmax())
    return grid.centers_mm[ridge_near(grid, grid.centers_mm[best])]


def is_ureter(grid: LumenGrid, ends: IntArray, pelvis_mm: Array, scale: float) -> NDArray[np.bool_]:
    """(E,) True for the one end (a voxel each) of the lumen that is the ureter, if any is.

    Calyces lie lateral of the pelvis, spread from pole to pole; the ureter leaves it towards the midline and, unlike a
    calyx, does not widen.
    """
    ureter = np.zeros(len(ends), bool)
    if len(ends) < 4:
        return ureter
    towards = grid.centers_mm[ends] - pelvis_mm
    lateral = [_lateral(np.delete(towards, i, axis=0)) @ t / np.linalg.norm(t) for i, t in enumerate(towards)]
    i = int(np.argmin(lateral))
    end = dijkstra(grid.graph, indices=ends[i], limit=_END_MM * scale) < _END_MM * scale
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(grid.centers_mm[end].T)))
    ureter[i] = lateral[i] < _MEDIAL and spread[1] < _SLENDER_MM * scale
    return ureter


def _farthest(graph: csr_array, voxel: int) -> int:
    way = dijkstra(graph, indices=voxel)
    return int(np.where(np.isfinite(way), way, -1).argmax())


def _lateral(towards: Array) -> Array:
    """(3,) unit mean of the directions from the pelvis to ends (E, 3), across the long axis of their spread."""
    axis = np.linalg.svd(towards - towards.mean(axis=0))[2][0]
    mean = towards.mean(axis=0)
    lateral = mean - axis * (mean @ axis)
    return lateral / np.linalg.norm(lateral)
