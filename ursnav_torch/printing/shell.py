"""The wall around the lumen: an even offset of its surface, open where the ureter ends."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import marching_cubes

from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.geodesic import ways_to
from ursnav_torch.kidney.grid import LumenGrid, distance_to_surface

Array = NDArray[np.float64]

#: Voxel of the offset, relative to the wall, and within which limits, mm.
_VOXEL_SHARE, _VOXEL_MM = 0.3, (0.3, 0.8)
#: The offset's triangles cut corners by up to this, mm.
_CHORD_MM = 0.05
#: An end of the lumen this far from every way to a calyx is the ureter's, mm at scale 1.
_URETER_MM = 7.0
#: Radius of an opening where no ureter is seen, mm at scale 1.
_URETER_RADIUS_MM = 2.0


def outer_surface(lumen: trimesh.Trimesh, wall_mm: float) -> trimesh.Trimesh:
    """The closed surface ``wall_mm`` outside a lumen (mm); pockets inside the wall are filled."""
    voxel = float(np.clip(_VOXEL_SHARE * wall_mm, *_VOXEL_MM))
    grid = LumenGrid.from_mesh(lumen, voxel)
    reach = wall_mm + _CHORD_MM
    pad = int(np.ceil(reach / voxel)) + 3
    inside = np.pad(grid.index >= 0, pad)
    origin = grid.origin_mm - pad * voxel
    distance = ndimage.distance_transform_edt(~inside) * voxel
    band = np.abs(distance - reach) < 2.5 * voxel
    distance[band] = distance_to_surface(lumen, origin + voxel * np.argwhere(band), edge_mm=max(voxel, 0.5))
    solid = ndimage.binary_fill_holes(distance < reach)
    field = np.where(solid & (distance >= reach), 0.5 * voxel, reach - distance)
    vertices, faces, *_ = marching_cubes(field, 0.0)
    mesh = trimesh.Trimesh(origin + voxel * vertices.astype(float), faces, process=True)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def ureter_end(kidney: Kidney) -> tuple[Array, Array, float] | None:
    """Where the ureter ends: a point (3,) in its middle, the unit direction (3,) out, its radius; None without one.

    It is the place farthest from all ways to calyces, along the lumen.
    """
    grid = LumenGrid.from_mesh(kidney.mesh, 0.5 * kidney.scale)
    tree = kidney.centerline
    way = ways_to(grid, grid.nearest(tree.points_mm), -tree.radius_mm).length_mm
    way[~np.isfinite(way)] = -np.inf
    end = int(way.argmax())
    if way[end] < _URETER_MM * kidney.scale:
        return None
    back = ways_to(grid, np.array([end]), limit_mm=8 * kidney.scale).length_mm
    near = [grid.centers_mm[back <= mm * kidney.scale].mean(axis=0) for mm in (3.0, 6.0)]
    direction = (near[0] - near[1]) / np.linalg.norm(near[0] - near[1])
    across = (grid.centers_mm[back <= 3.0 * kidney.scale] - near[0]) @ np.eye(3)
    off = across - np.outer(across @ direction, direction)
    radius = float(np.sqrt(2 * np.mean(np.sum(off**2, axis=1))))  # of a disk with that spread
    return near[0], direction, radius


def pelvis_exit(kidney: Kidney) -> tuple[Array, Array, float]:
    """Where a ureter would leave: a point (3,) just inside the wall, the direction (3,) out, and a ureter's radius.

    The direction leads from the pelvis away from the calyces.
    """
    out = kidney.pelvis_mm - kidney.tips_mm.mean(axis=0)
    out /= np.linalg.norm(out)
    hits = kidney.mesh.ray.intersects_location(kidney.pelvis_mm[None], out[None])[0]
    exit_mm = float(((np.asarray(hits) - kidney.pelvis_mm) @ out).max(initial=0.0))
    return kidney.pelvis_mm + out * max(exit_mm - 2.0 * kidney.scale, 0.0), out, _URETER_RADIUS_MM * kidney.scale
