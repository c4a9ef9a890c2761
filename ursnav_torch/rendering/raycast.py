"""Rendering by ray casting (embree): any lens, exact depth, no OpenGL."""

import numpy as np
import trimesh
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.base import View
from ursnav_torch.rendering.light import HeadLight, Light


class RayScene:
    """A mesh that rays can be cast at; normals are interpolated over each triangle.

    Args:
        mesh: the lumen in the kidney frame, mm, normals outward.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._corners = np.asarray(mesh.vertex_normals, np.float32)[np.asarray(mesh.faces)]  # (F, 3, 3)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, np.asarray(mesh.triangles, np.float32))

    def cast(self, origins_mm: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances (N,) in mm along unit ``directions`` (N, 3) from ``origins_mm`` (N, 3) or (3,), inf without a
        wall, and the mesh's outward unit normals there (N, 3), zero without a wall; all in the kidney frame."""
        directions = np.ascontiguousarray(directions, np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origins_mm, np.float32), directions.shape))
        hits = self._scene.run(origins, directions, output=True)
        face = hits["primID"]
        wall = face >= 0
        depth = np.full(len(directions), np.inf, np.float32)
        depth[wall] = hits["tfar"][wall]
        normals = np.zeros((len(directions), 3), np.float32)
        u, v = hits["u"][wall], hits["v"][wall]
        share = np.stack([1 - u - v, u, v], axis=1)
        smooth = np.einsum("nk,nki->ni", share, self._corners[face[wall]])
        size = np.sqrt(np.einsum("ni,ni->n", smooth, smooth))
        normals[wall] = smooth / np.maximum(size, 1e-9)[:, None]
        return depth, normals


class RaycastRenderer:
    """Casts one ray a pixel against the lumen's triangles.

    Args:
        mesh: the lumen in the kidney frame, mm, normals outward.
        camera: the lens.
        light: how walls become gray values; a `HeadLight` at the camera by default.
    """

    def __init__(self, mesh: trimesh.Trimesh, camera: Camera, light: Light | None = None) -> None:
        self.camera = camera
        self.light: Light = light or HeadLight()
        self.scene = RayScene(mesh)
        rays, self._mask = camera.pixel_rays()
        self._rays_camera = rays[self._mask].astype(np.float32)

    def render(self, T_kidney_camera: NDArray[np.float64]) -> View:
        """The view from one pose (4, 4)."""
        R, t = T_kidney_camera[:3, :3].astype(np.float32), T_kidney_camera[:3, 3]
        depth, normals_kidney = self.scene.cast(t, self._rays_camera @ R.T)
        hit = np.isfinite(depth)
        normals_camera = -normals_kidney @ R  # the mesh's normals leave the lumen; a view's point at the camera
        gray = np.zeros(len(depth))
        gray[hit] = self.light.shade(self._rays_camera[hit] * depth[hit, None], normals_camera[hit])
        shape = self._mask.shape
        image = np.zeros(shape, np.uint8)
        image[self._mask] = np.round(255 * gray).astype(np.uint8)
        depth_mm = np.full(shape, np.nan, np.float32)
        depth_mm[self._mask] = depth
        normals = np.zeros((*shape, 3), np.float32)
        normals[self._mask] = normals_camera
        return View(image, depth_mm, normals)
