"""Solids that can be joined and cut exactly, by manifold3d."""

from types import ModuleType
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra

Array = NDArray[np.float64]


def manifold3d() -> ModuleType:
    """The package manifold3d.

    Raises:
        MissingExtraError: it is not installed.
    """
    return import_extra("manifold3d", "ct", "print_phantom")


def solid_of(mesh: trimesh.Trimesh, name: str) -> Any:
    """A manifold of a closed mesh.

    Raises:
        InputError: the mesh does not enclose a volume.
    """
    m = manifold3d()
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    solid = m.Manifold(m.Mesh64(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.uint64)))
    if solid.is_empty():
        raise InputError(
            f"The surface of {name} does not enclose a solid ({solid.status()}): make it manifold, e.g. by building "
            "it from a label map, or with the repair function of the program that made it."
        )
    return solid


def mesh_of(solid: Any) -> trimesh.Trimesh:
    """The closed surface of a manifold."""
    data = solid.to_mesh64()
    return trimesh.Trimesh(data.vert_properties[:, :3], data.tri_verts.astype(np.int64), process=False)


def rod(start_mm: Array, end_mm: Array, radius_mm: float, end_radius_mm: float | None = None) -> Any:
    """A cylinder, or a cone, between two points (3,)."""
    m = manifold3d()
    length = float(np.linalg.norm(end_mm - start_mm))
    upright = m.Manifold.cylinder(length, radius_mm, radius_mm if end_radius_mm is None else end_radius_mm, 48)
    R = frame_along((end_mm - start_mm) / length)
    return upright.transform(np.column_stack([R, start_mm]).tolist())


def frame_along(axis: Array) -> Array:
    """(3, 3) rotation whose third column is a unit vector (3,)."""
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(axis, side), axis])
