"""Landmarks gathered by touching with the sensor and by picking on the model (thesis section 4.4, Fig. 4.13-4.14)."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.geometry import Array


def touched_points(sensor_mm: ArrayLike, axis: ArrayLike, reach_mm: float) -> Array:
    """(N, 3) points that a sensor touches ``reach_mm`` in front of its reported position, along its axis.

    A tracker reports the sensor's center, half its length behind the point that touches.

    Args:
        sensor_mm: (N, 3) reported positions.
        axis: (N, 3) the sensor's axes, pointing forward; any length.
        reach_mm: from the reported position to the tip.

    Raises:
        ShapeError: positions and axes do not fit.
        InputError: an axis is zero or not finite.
    """
    p, d = np.asarray(sensor_mm, float), np.asarray(axis, float)
    if p.ndim != 2 or p.shape[-1] != 3 or p.shape != d.shape:
        raise ShapeError(f"Expected positions and axes (N, 3), got {p.shape} and {d.shape}.")
    length = np.linalg.norm(d, axis=1, keepdims=True)
    if not np.all(length > 1e-9):
        raise InputError("A sensor axis is zero or not finite; every touch needs dx, dy, dz.")
    return p + reach_mm * d / length


def picked_points(picks_mm: ArrayLike, mesh: trimesh.Trimesh, stand_off_mm: float = 0.0) -> Array:
    """(N, 3) points picked on the model, put on its surface and ``stand_off_mm`` out along its normal.

    With a stand-off of half the sensor's length these are the centers of the spheres that the thesis laid on the
    surface: partners of the reported positions, where the sensor was held square to the wall.
    """
    on_surface, _, face = trimesh.proximity.closest_point(mesh, np.asarray(picks_mm, float).reshape(-1, 3))
    return np.asarray(on_surface) + stand_off_mm * mesh.face_normals[face]
