"""Light between the walls: one diffuse bounce, gathered from patches of the wall in sight.

The patches stand for equal shares of the picture, each with the area that it has on the wall; what the camera does
not see sends nothing (Cohen and Wallace, Radiosity and Realistic Image Synthesis, 1993, form factors by points).
"""

import numpy as np

from ursnav_torch.rendering.sensor.surface import Floats, Surface

#: Patches of the wall that light is gathered from.
_PATCHES = 100
#: Points whose light is gathered at once, so that it stays in the cache.
_CHUNK = 512
#: A patch is no point: squared distances are no smaller than this share of its area.
_NEAR = 0.5


def bounced(surface: Surface, normals: Floats, reflectance: Floats, irradiance: Floats) -> Floats:
    """Irradiance (N, 3) that reaches every seen point by way of one other.

    Args:
        surface: N points.
        normals: (N, 3) unit, camera frame.
        reflectance: (N, 3) diffuse, 0 to 1.
        irradiance: (N,) direct light.
    """
    n = len(surface.pixels)
    if n < _PATCHES:
        return np.zeros((n, 3), np.float32)
    rows = np.linspace(0, n - 1, _PATCHES).astype(int)
    points = surface.rays * surface.distance_mm[:, None]
    facing = np.maximum(-np.einsum("ij,ij->i", surface.rays[rows], normals[rows]), 0.15)
    area = np.square(surface.distance_mm[rows]) / facing * _solid_angle(surface.rays) / _PATCHES
    sent = reflectance[rows] * (irradiance[rows] * area / np.pi)[:, None]
    out = np.empty((n, 3), np.float32)
    for start in range(0, n, _CHUNK):
        part = slice(start, start + _CHUNK)
        out[part] = _gathered(points[part], normals[part], points[rows], normals[rows], area.astype(np.float32)) @ sent
    return out


def _gathered(here: Floats, normals: Floats, there: Floats, normals_there: Floats, area: Floats) -> Floats:
    """Form factors by the patches' areas (N, M) between points (N, 3) and patches (M, 3)."""
    at_here = normals @ there.T
    at_here -= np.einsum("ij,ij->i", normals, here)[:, None]
    at_there = here @ normals_there.T
    at_there -= np.einsum("ij,ij->i", normals_there, there)[None]
    square = here @ there.T
    square *= -2
    square += np.einsum("ij,ij->i", here, here)[:, None]
    square += np.einsum("ij,ij->i", there, there)[None]
    np.maximum(square, _NEAR * area[None], out=square)
    np.maximum(at_here, 0, out=at_here)
    at_here *= np.maximum(at_there, 0, out=at_there)
    square *= square
    at_here /= square
    return at_here


def _solid_angle(rays: Floats) -> float:
    """Of the cone that the rays (N, 3) fill, in steradian."""
    return float(2 * np.pi * (1 - rays[:, 2].min()))
