"""The tips of the minor calyces, found from the shape of the lumen alone.

An end of the lumen is a place that is farther from the pelvis than all around it, or that stands out of the trunk to
the side. Ends of one cup see each other; corners of the pelvis and the ureter are left out. The lengths in these rules
are mm at scale 1 and come from anatomy: a cup is some 6 mm deep and up to 9 mm wide, its end stands out by more than
the unevenness of a wall, and no calyx ends within 15 mm of the middle of the pelvis.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.geodesic import ways_to
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.peaks import prominent_peaks
from ursnav_torch.kidney.pelvis import is_ureter
from ursnav_torch.kidney.tree import central_paths, ridge_near

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: By how much an end must stand out from what lies between it and the next.
_PROMINENCE_MM = 1.2
#: By how much an end to the side must stand out of the trunk.
_ASIDE_MM = 2.2
#: Depth and width of a cup.
_CUP_DEPTH_MM, _CUP_WIDTH_MM = 6.0, 9.0
#: Two ends see each other if the way between them is at most this much longer than the straight line.
_SEEING = 1.15
#: Ends and tips nearer to each other than this are one.
_APART_MM = 5.0
#: What ends nearer to the middle of the pelvis, or within this share of the median way, is a corner of the pelvis.
_PELVIS_MM, _PELVIS_SHARE = 15.0, 0.6
#: The floor of a cup: what lies within this of its end, or to the side stands out by this share of what the end does.
_FLOOR_MM, _FLOOR_SHARE = 2.0, 0.5
#: A tip lies at least this far from the wall.
_CLEARANCE_MM = 0.7


def find_tips(grid: LumenGrid, pelvis_mm: ArrayLike, scale: float) -> Array:
    """(C, 3) tips of the minor calyces: each the middle of the floor of its cup, just off the wall.

    Raises:
        InputError: nothing stands out of the pelvis.
    """
    root = ridge_near(grid, pelvis_mm)
    way = ways_to(grid, np.array([root])).length_mm
    way[~np.isfinite(way)] = -1.0
    far, _ = prominent_peaks(way, grid.graph, _PROMINENCE_MM * scale)
    taken = way <= min(_PELVIS_MM * scale, _PELVIS_SHARE * float(np.median(way[far])))
    ends: list[int] = []
    tips: list[Array] = []
    for end in _ends(grid, root, way, far, scale):
        if taken[end.voxel]:
            continue
        cup = _cup(grid, end.voxel, scale)
        floor = _side_floor(grid, end, scale) if end.aside else cup & (end.field >= end.level)
        tip = _off_the_wall(grid, grid.centers_mm[floor].mean(axis=0), scale)
        if all(np.linalg.norm(tip - t) >= _APART_MM * scale for t in tips):
            taken |= cup
            ends.append(end.voxel)
            tips.append(tip)
    keep = ~is_ureter(grid, np.array(ends, int), grid.centers_mm[root], scale)
    if not np.any(keep):
        raise InputError(
            "No calyx was found: nothing stands out of the pelvis. Is the mesh a whole collecting system? "
            "If so, give the tips with kidney.calyces=FILE."
        )
    return np.array(tips)[keep]


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """An end of the lumen: a peak of a field (V,), the level that its floor reaches, and whether it is to the side."""

    voxel: int
    field: Array
    level: float
    aside: bool


def _ends(grid: LumenGrid, root: int, way: Array, far: IntArray, scale: float) -> list[_End]:
    """The ends that are farther from the pelvis than all around them, then those to the side of the ways there."""
    out = _out_of(grid, _trunk(grid, root, far, scale))
    aside, prominence = prominent_peaks(out, grid.graph, _PROMINENCE_MM * scale)
    levels = np.maximum(out[aside] - prominence, _FLOOR_SHARE * out[aside])
    return [_End(int(v), way, way[v] - _FLOOR_MM * scale, False) for v in far] + [
        _End(int(v), out, level, True) for v, level in zip(aside, levels, strict=True) if out[v] > _ASIDE_MM * scale
    ]


def _trunk(grid: LumenGrid, root: int, ends: IntArray, scale: float) -> IntArray:
    """Voxels along the central paths to the ends, short of their cups."""
    towards = central_paths(grid, root)
    trunk = {root}
    for end in ends:
        path = [int(end)]
        while path[-1] != root and towards[path[-1]] >= 0:
            path.append(int(towards[path[-1]]))
        straight = np.linalg.norm(grid.centers_mm[path] - grid.centers_mm[end], axis=1)
        trunk.update(np.array(path)[straight > _CUP_DEPTH_MM * scale].tolist())
    return np.array(sorted(trunk))


def _out_of(grid: LumenGrid, trunk: IntArray) -> Array:
    """(V,) how far every voxel lies along the lumen beyond the balls inscribed along the trunk."""
    length = ways_to(grid, trunk, -grid.radius_mm[trunk]).length_mm
    return np.where(np.isfinite(length), length, -1.0)


def _cup(grid: LumenGrid, end: int, scale: float) -> NDArray[np.bool_]:
    """(V,) what belongs to the cup of an end: near it, or seen from it across the width of a cup."""
    way = ways_to(grid, np.array([end]), limit_mm=1.13 * _CUP_WIDTH_MM * scale).length_mm
    straight = np.linalg.norm(grid.centers_mm - grid.centers_mm[end], axis=1)
    seen = (way < _CUP_WIDTH_MM * scale) & (way < _SEEING * straight)
    return seen | (way < _APART_MM * scale)


def _side_floor(grid: LumenGrid, end: _End, scale: float) -> NDArray[np.bool_]:
    """(V,) what is connected with an end to the side above its level, papilla or not."""
    near = np.linalg.norm(grid.centers_mm - grid.centers_mm[end.voxel], axis=1) < 2 * _CUP_DEPTH_MM * scale
    high = np.flatnonzero(near & (end.field >= end.level))
    label = connected_components(grid.graph[high][:, high], directed=False)[1]
    floor = np.zeros(len(near), bool)
    floor[high[label == label[np.searchsorted(high, end.voxel)]]] = True
    return floor


def _off_the_wall(grid: LumenGrid, point_mm: Array, scale: float) -> Array:
    """(3,) the voxel nearest to a point that is not too near the wall."""
    free = grid.centers_mm[grid.radius_mm >= min(_CLEARANCE_MM * scale, grid.radius_mm.max())]
    return free[np.linalg.norm(free - point_mm, axis=1).argmin()]
