"""The wall as the camera sees it: one row a pixel that shows wall."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.base import View

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Surface:
    """The seen wall, N pixels of it.

    Attributes:
        pixels: (N,) flat pixel indices.
        rays: (N, 3) unit viewing directions, camera frame.
        distance_mm: (N,) along the ray.
        normals: (N, 3) unit, pointing at the camera, camera frame.
        points_kidney: (N, 3) mm, kidney frame: what texture is anchored to.
        R_kidney_camera: (3, 3).
    """

    pixels: NDArray[np.intp]
    rays: Floats
    distance_mm: Floats
    normals: Floats
    points_kidney: Floats
    R_kidney_camera: Floats


def surface_of(view: View, camera: Camera, T_kidney_camera: NDArray[np.float64]) -> Surface:
    """The wall of one view from pose ``T_kidney_camera`` (4, 4)."""
    pixels = np.flatnonzero(np.isfinite(view.depth_mm))
    rays = lens_rays(camera)[0].reshape(-1, 3)[pixels]
    distance = view.depth_mm.reshape(-1)[pixels]
    R, t = T_kidney_camera[:3, :3].astype(np.float32), T_kidney_camera[:3, 3].astype(np.float32)
    points = np.asarray((rays * distance[:, None]) @ R.T + t, np.float32)
    return Surface(pixels, rays, distance, view.normals.reshape(-1, 3)[pixels], points, R)


@lru_cache(maxsize=8)
def lens_rays(camera: Camera) -> tuple[Floats, Mask]:
    """`Camera.pixel_rays`, directions (H, W, 3) in float32 and mask (H, W), kept for the next picture."""
    rays, mask = camera.pixel_rays()
    return rays.astype(np.float32), mask
