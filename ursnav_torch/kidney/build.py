"""From a checked lumen to a kidney: pelvis, calyces, centerline, names."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Calyx, Kidney
from ursnav_torch.kidney.checks import check_radius
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.naming import name_calyces, with_poles
from ursnav_torch.kidney.pelvis import find_pelvis
from ursnav_torch.kidney.tips import find_tips
from ursnav_torch.kidney.tree import grow_tree

Array = NDArray[np.float64]

#: Voxel for the centerline and the calyces, mm at scale 1.
_VOXEL_MM = 0.5
#: How far outside the lumen a given tip may lie, mm at scale 1.
_OUTSIDE_MM = 3.0


def build_kidney(
    mesh: trimesh.Trimesh,
    source: str,
    scale: float,
    calyces: tuple[Calyx, ...] | None,
    pelvis_mm: Array | None,
    superior: ArrayLike | None,
) -> Kidney:
    """A kidney from its checked lumen; calyces and pelvis (3,) are found where they are None.

    Raises:
        InputError: a given point lies outside the lumen, or the lumen is none.
    """
    grid = LumenGrid.from_mesh(mesh, _VOXEL_MM * scale)
    check_radius(float(grid.wall_mm.max()), source, scale)
    points = {"pelvis": pelvis_mm} if pelvis_mm is not None else {}
    points |= {c.name: c.tip_mm for c in calyces or ()}
    for name, point in points.items():
        if grid.clearance_mm(point)[0] < -_OUTSIDE_MM * scale:
            raise InputError(
                f"{name} at {np.round(point, 1).tolist()} lies {-grid.clearance_mm(point)[0]:.1f} mm outside the lumen "
                f"of {source}. The points must be in the mesh's own coordinates, in mm."
            )
    pelvis = find_pelvis(grid, scale) if pelvis_mm is None else pelvis_mm
    if calyces is None:
        tips = find_tips(grid, pelvis, scale)
        calyces = name_calyces(grow_tree(grid, pelvis, tips), tips)
    if superior is not None:
        calyces = with_poles(calyces, superior)
    centerline = grow_tree(grid, pelvis, np.array([c.tip_mm for c in calyces]))
    return Kidney(mesh, calyces, centerline, centerline.points_mm[0], scale, source)
