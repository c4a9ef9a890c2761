"""Rendering by OpenGL (pyrender on EGL): a pinhole natively, a fisheye by the faces of a cube and a remap.

Only depth and normals come from OpenGL; the same `Light` as in ray casting makes gray values of them. Depth is drawn
without multisampling, which would blend near and far walls at silhouettes.
"""

import os
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.errors import MissingExtraError
from ursnav_torch.geometry import T_OPENGL_OPENCV, transform_from
from ursnav_torch.rendering.base import View
from ursnav_torch.rendering.light import HeadLight, Light

_NEAR_MM = 0.05
_OVERSAMPLING = 2.0  # cube pixels a fisheye pixel, at the image center
_BEND = 0.05  # 1 / depth bending by more from pixel to pixel, relatively, is the border of two walls


@dataclass(frozen=True, slots=True)
class _Face:
    """One pinhole picture: its axes in the camera frame, its intrinsics, and what of the lens it fills.

    ``pixels`` (N,) are flat indices of the lens's pixels, ``columns`` and ``rows`` (N, 1) where they lie in the face,
    ``stretch`` (N,) distance along the ray by depth along the face's axis.
    """

    R_camera_face: NDArray[np.float64]
    focal: tuple[float, float]
    center: tuple[float, float]
    size: tuple[int, int]
    pixels: NDArray[np.intp]
    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    stretch: NDArray[np.float32]


class PyrenderRenderer:
    """Draws the lumen with pyrender, always from the thread that made the first one: OpenGL contexts do not travel.

    Args:
        mesh: the lumen in the kidney frame, mm, normals outward.
        camera: the lens.
        light: how walls become gray values; a `HeadLight` at the camera by default.

    Raises:
        MissingExtraError: OpenGL cannot draw without a display here; the message names what to install.
    """

    def __init__(self, mesh: trimesh.Trimesh, camera: Camera, light: Light | None = None) -> None:
        self.camera = camera
        self.light: Light = light or HeadLight()
        rays, self._mask = camera.pixel_rays()
        self._rays = rays[self._mask]
        self._faces = _lens_faces(camera, self._rays)
        self._gl, self._offscreen = _offscreen(os.getpid())
        self._scene = self._gl.Scene(bg_color=np.zeros(4))
        self._lumen = self._scene.add(_inside_mesh(self._gl, mesh))
        far = 1.5 * float(np.linalg.norm(mesh.extents)) + 1
        self._cameras = [
            self._gl.IntrinsicsCamera(*face.focal, face.center[0] + 0.5, face.center[1] + 0.5, _NEAR_MM, far)
            for face in self._faces
        ]

    def render(self, T_kidney_camera: NDArray[np.float64]) -> View:
        """The view from one pose (4, 4)."""
        depth = np.full(len(self._rays), np.inf, np.float32)
        normals = np.zeros((len(self._rays), 3), np.float32)
        for face, camera in zip(self._faces, self._cameras, strict=True):
            T_kidney_face = T_kidney_camera @ transform_from(face.R_camera_face, np.zeros(3))
            z_mm, packed = self._draw(camera, T_kidney_face @ T_OPENGL_OPENCV)
            depth[face.pixels] = face.stretch * _sampled_depth(z_mm, face)
            normals[face.pixels] = _sampled_normals(packed, face)
        normals = -normals @ T_kidney_camera[:3, :3].astype(np.float32)  # outward to inward, kidney to camera
        normals[~np.isfinite(depth)] = 0
        return self._view(depth, normals)

    def _draw(self, camera: Any, T_kidney_opengl: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth along the axis (H, W), 0 without a wall, and the mesh's normals packed into bytes (H, W, 3)."""
        node = self._scene.add(camera, pose=T_kidney_opengl)
        flags = self._gl.RenderFlags
        self._offscreen.viewport_width, self._offscreen.viewport_height = self._faces[0].size
        try:
            whole = {self._lumen: (255, 255, 255)}
            _, z_mm = self._offscreen.render(self._scene, flags.SEG, seg_node_map=whole)  # no multisampling
            packed, _ = self._offscreen.render(self._scene, flags.FLAT)
        finally:
            self._scene.remove_node(node)
        return z_mm, packed

    def _view(self, depth: NDArray[np.float32], normals: NDArray[np.float32]) -> View:
        hit = np.isfinite(depth)
        gray = np.zeros(len(depth))
        gray[hit] = self.light.shade(self._rays[hit] * depth[hit, None], normals[hit])
        image = np.zeros(self._mask.shape, np.uint8)
        image[self._mask] = np.round(255 * gray).astype(np.uint8)
        depth_mm = np.full(self._mask.shape, np.nan, np.float32)
        depth_mm[self._mask] = depth
        normals_image = np.zeros((*self._mask.shape, 3), np.float32)
        normals_image[self._mask] = normals
        return View(image, depth_mm, normals_image)


@lru_cache(maxsize=1)
def _offscreen(process: int) -> tuple[Any, Any]:
    """Pyrender and the one OpenGL context of this ``process``: pyrender ends them all when it deletes one."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    try:
        import pyrender

        return pyrender, pyrender.OffscreenRenderer(64, 64)
    except Exception as error:  # PyOpenGL raises whatever it stumbles over where a library is missing
        raise _no_opengl(error) from error


def _no_opengl(error: Exception) -> MissingExtraError:
    return MissingExtraError(
        f"OpenGL cannot draw without a display here ({type(error).__name__}: {error}; PYOPENGL_PLATFORM="
        f"{os.environ.get('PYOPENGL_PLATFORM')}). On Debian: apt-get install libegl1 libgl1-mesa-dri; or use "
        "rendering=raycast, which needs no OpenGL."
    )


def _inside_mesh(gl: Any, mesh: trimesh.Trimesh) -> Any:
    """The lumen with its triangles turned inward (the scope is inside) and its outward normals as colors."""
    normals = np.asarray(mesh.vertex_normals, np.float32)
    colors = np.ones((len(normals), 4), np.float32)
    colors[:, :3] = (normals + 1) / 2
    primitive = gl.Primitive(
        positions=np.asarray(mesh.vertices, np.float32), normals=-normals, color_0=colors,
        indices=np.asarray(mesh.faces)[:, ::-1], material=gl.MetallicRoughnessMaterial(baseColorFactor=np.ones(4)),
    )  # fmt: skip
    return gl.Mesh([primitive])


def _lens_faces(camera: Camera, rays: NDArray[np.float64]) -> list[_Face]:
    if camera.model == "pinhole":
        size = (camera.width, camera.height)
        face = _face(np.eye(3), (camera.fx, camera.fy), (camera.cx, camera.cy), size, rays, np.arange(len(rays)))
        return [face]
    side = int(np.ceil(2 * _OVERSAMPLING * max(camera.fx, camera.fy)))
    focal = (side / 2 - 1.5,) * 2  # a little wider than 90 degrees, so that edge pixels have neighbors
    x, y, z = np.eye(3)
    axes = [(x, y), (-z, y), (z, y), (x, -z), (x, z), (-x, y)]  # ahead, right, left, down, up, behind
    faces = [np.stack([right, down, np.cross(right, down)], axis=1) for right, down in axes]
    nearest = np.argmax(np.stack([rays @ R[:, 2] for R in faces]), axis=0)
    return [
        _face(R, focal, ((side - 1) / 2,) * 2, (side, side), rays, np.flatnonzero(nearest == i))
        for i, R in enumerate(faces)
        if np.any(nearest == i)
    ]


def _face(
    R_camera_face: NDArray[np.float64], focal: tuple[float, float], center: tuple[float, float],
    size: tuple[int, int], rays: NDArray[np.float64], pixels: NDArray[np.intp],
) -> _Face:  # fmt: skip
    x, y, z = (rays[pixels] @ R_camera_face).T
    columns, rows = focal[0] * x / z + center[0], focal[1] * y / z + center[1]
    return _Face(
        R_camera_face, focal, center, size, pixels,
        columns[:, None].astype(np.float32), rows[:, None].astype(np.float32), (1 / z).astype(np.float32),
    )  # fmt: skip


def _sampled_depth(z_mm: NDArray[np.float32], face: _Face) -> NDArray[np.float32]:
    """(N,) depth along the face's axis, inf without a wall: 1 / depth is linear over a flat wall, so it is what is
    interpolated; at silhouettes the nearest pixel counts alone."""
    inverse = np.zeros_like(z_mm)
    np.divide(1, z_mm, out=inverse, where=z_mm > 0)
    second = np.array([[1.0, -2.0, 1.0]])
    bend = np.maximum(np.abs(cv2.filter2D(inverse, -1, second)), np.abs(cv2.filter2D(inverse, -1, second.T)))
    smooth = (cv2.dilate(bend, np.ones((3, 3))) < _BEND * inverse).astype(np.uint8)
    linear, nearest = (
        cv2.remap(inverse, face.columns, face.rows, how, borderMode=cv2.BORDER_REPLICATE)[:, 0]
        for how in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
    )
    on_wall = cv2.remap(smooth, face.columns, face.rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)[:, 0] > 0
    value = np.where(on_wall, linear, nearest)
    return np.divide(1, value, out=np.full_like(value, np.inf), where=value > 0)


def _sampled_normals(packed: NDArray[np.uint8], face: _Face) -> NDArray[np.float32]:
    """(N, 3) unit normals, kidney frame, as the mesh has them (outward)."""
    bytes_ = cv2.remap(
        packed.astype(np.float32), face.columns, face.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    normals = bytes_[:, 0] / 127.5 - 1
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
