"""A centerline drawn in 3D Slicer: one curve a calyx, from the pelvis to its tip, joined to a tree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Centerline, Kidney
from ursnav_torch.kidney.grid import LumenGrid

Array = NDArray[np.float64]

#: Nodes along a curve, where curves are one, and how far a curve's end may be from its tip, mm.
_STEP_MM, _JOINED_MM, _END_MM = 0.5, 1.0, 6.0
_VOXEL_MM = 0.5


def with_curves(kidney: Kidney, curves: Sequence[Array], source: str) -> Kidney:
    """The kidney with the centerline that curves (N, 3), kidney frame, draw; each runs either way.

    Raises:
        InputError: a calyx has no curve, or a curve leaves the lumen.
    """
    root = kidney.pelvis_mm
    points, parent, calyx = [root], [-1], [-1]
    for number, tip in enumerate(kidney.tips_mm):
        way = np.vstack([_curve_to(curves, tip, kidney.calyces[number].name, source), tip])
        shared = np.linalg.norm(way[:, None] - np.array(points), axis=-1)
        near = np.flatnonzero(shared.min(axis=1) < _JOINED_MM)
        first = int(near[-1]) + 1 if len(near) else 0
        at = int(shared[max(first - 1, 0)].argmin())
        first = min(first, len(way) - 1)
        node = at
        while node >= 0:  # what leads to several calyces belongs to none
            calyx[node] = -1
            node = parent[node]
        for point in way[first:]:
            points.append(point)
            parent.append(at)
            calyx.append(number)
            at = len(points) - 1
    nodes = np.array(points)
    clearance = LumenGrid.from_mesh(kidney.mesh, _VOXEL_MM * kidney.scale).clearance_mm(nodes)
    if clearance.min() < -1.0:
        raise InputError(
            f"{source}: the curves leave the lumen by up to {-clearance.min():.1f} mm. Were they drawn on this scan?"
        )
    tree = Centerline(nodes, np.maximum(clearance, 0.0), np.array(parent), np.array(calyx))
    return replace(kidney, centerline=tree)


def _curve_to(curves: Sequence[Array], tip: Array, name: str, source: str) -> Array:
    """(K, 3) the curve that ends at a tip, from the pelvis on, a node every half millimeter, less its last one."""
    ends = np.array([[np.linalg.norm(c[0] - tip), np.linalg.norm(c[-1] - tip)] for c in curves]).reshape(-1, 2)
    if not len(ends) or ends.min() > _END_MM:
        raise InputError(
            f"{source} has no curve that ends within {_END_MM:g} mm of calyx {name}; draw one a calyx, from the "
            "pelvis to its tip."
        )
    which, last = np.unravel_index(ends.argmin(), ends.shape)
    curve = curves[int(which)] if last == 1 else curves[int(which)][::-1]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    at = np.linspace(0, along[-1], max(int(along[-1] / _STEP_MM), 2))
    return np.stack([np.interp(at, along, curve[:, k]) for k in range(3)], axis=1)[:-1]
