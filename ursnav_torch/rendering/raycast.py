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
        corners = np.asarray(mesh.vertex_normals, np.float32)[np.asarray(mesh.faces)]  # (F, 3, 3)
        # Number by number, (corner, axis, F): what is long comes last, which NumPy works through without a pause.
        self._corners = np.ascontiguousarray(corners.transpose(1, 2, 0))
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, np.asarray(mesh.triangles, np.float32))

    def depth_mm(self, origins_mm: ArrayLike, directions: ArrayLike) -> NDArray[np.float32]:
        """Distances (N,) in mm as `cast` tells them, at less cost as there are no normals; huge without a wall."""
        directions = np.ascontiguousarray(directions, np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origins_mm, np.float32), directions.shape))
        return np.asarray(self._scene.run(origins, directions, query="DISTANCE"))

    def cast(self, origins_mm: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances (N,) in mm along unit ``directions`` (N, 3) from ``origins_mm`` (N, 3) or (3,), inf without a
        wall, and the mesh's outward unit normals there (N, 3), zero without a wall; all in the kidney frame."""
        directions = np.ascontiguousarray(directions, np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origins_mm, np.float32), directions.shape))
        hits = self._scene.run(origins, directions, output=True)
        face = hits["primID"]
        wall = face >= 0
        depth = np.where(wall, hits["tfar"], np.float32(np.inf))
        if wall.all():
            return depth, self._normals(face, hits["u"], hits["v"]).T
        normals = np.zeros((3, len(directions)), np.float32)
        normals[:, wall] = self._normals(face[wall], hits["u"][wall], hits["v"][wall])
        return depth, normals.T

    def _normals(self, face: NDArray[np.int32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit normals (3, N) in faces (N,) at barycentric coordinates u and v (N,)."""
        first = 1 - u - v
        a, b, c = (corner.take(face, 1, mode="clip") for corner in self._corners)  # clip: no check, and no copy of it
        a *= first
        a += u * b
        a += v * c
        a /= np.maximum(np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]), 1e-9)
        return a


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
        self._rays_by_axis = np.ascontiguousarray(self._rays_camera.T)
        self._pixels = np.flatnonzero(self._mask)

    def render(self, T_kidney_camera: NDArray[np.float64]) -> View:
        """The view from one pose (4, 4)."""
        R, t = T_kidney_camera[:3, :3].astype(np.float32), T_kidney_camera[:3, 3]
        depth, normals_kidney = self.scene.cast(t, self._rays_camera @ R.T)
        normals = -R.T @ normals_kidney.T  # (3, N); the mesh's normals leave the lumen, a view's point at the camera
        gray = self._shaded(depth, normals)
        shape = self._mask.shape
        image = np.zeros(shape, np.uint8)
        image.reshape(-1)[self._pixels] = np.rint(255 * gray).astype(np.uint8)
        depth_mm = np.full(shape, np.nan, np.float32)
        depth_mm.reshape(-1)[self._pixels] = depth
        normals_camera = np.zeros((*shape, 3), np.float32)
        normals_camera.reshape(-1, 3)[self._pixels] = normals.T
        return View(image, depth_mm, normals_camera)

    def _shaded(self, depth: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.floating]:
        """Gray values (N,) in 0..1 at distances (N,) along the rays with normals (3, N); 0 without a wall."""
        hit = np.isfinite(depth)
        if hit.all():
            return self.light.shade((self._rays_by_axis * depth).T, normals.T)
        gray = np.zeros(len(depth))
        gray[hit] = self.light.shade((self._rays_by_axis[:, hit] * depth[hit]).T, normals[:, hit].T)
        return gray
