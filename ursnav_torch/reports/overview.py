"""The kidney from outside, translucent, with cameras drawn into it; plain ray casting, no display needed."""

from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.geometry import apply
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RayScene

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_TISSUE = np.array([150.0, 145.0, 225.0])  # blue, green, red
_INK = (60, 60, 60)
#: Camera axes x, y, z as red, green, blue lines.
_AXES = ((40, 40, 220), (40, 170, 40), (220, 90, 30))


@dataclass(frozen=True, slots=True)
class Overview:
    """A translucent picture of a kidney and the projection it was drawn with.

    Attributes:
        picture: (S, S, 3) uint8, blue, green, red.
        T_view_kidney: (4, 4) kidney to view coordinates: x right, y down, z away, mm.
        px_per_mm: parallel projection; the picture's center is the view's origin.
    """

    picture: Picture
    T_view_kidney: Array
    px_per_mm: float

    def project(self, points_kidney: Array) -> Array:
        """Pixels (N, 2) of points (N, 3)."""
        center = (self.picture.shape[0] - 1) / 2
        return apply(self.T_view_kidney, np.asarray(points_kidney, float))[..., :2] * self.px_per_mm + center

    def with_camera(self, T_kidney_camera: Array, fov_deg: float = 90.0, reach_mm: float = 7.0) -> Picture:
        """The picture with a camera's place, axes and field of view (thesis Fig. 5.27)."""
        picture = self.picture.copy()
        half = np.radians(min(fov_deg, 120.0)) / 2
        around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = reach_mm * np.stack(
            [np.sin(half) * np.cos(around), np.sin(half) * np.sin(around), np.full(24, np.cos(half))], axis=1
        )
        tip, cone = self._at(T_kidney_camera, np.zeros((1, 3)))[0], self._at(T_kidney_camera, ring)
        veil = picture.copy()
        cv2.fillConvexPoly(veil, cv2.convexHull(np.concatenate([tip[None], cone])), (120, 220, 255), cv2.LINE_AA)
        picture = cv2.addWeighted(veil, 0.45, picture, 0.55, 0)
        for axis, color in zip(reach_mm * np.eye(3), _AXES, strict=True):
            cv2.arrowedLine(
                picture, tip, self._at(T_kidney_camera, axis[None])[0], color, 2, cv2.LINE_AA, tipLength=0.25
            )
        cv2.circle(picture, tip, 4, (20, 20, 20), -1, cv2.LINE_AA)
        return np.asarray(picture, np.uint8)

    def _at(self, T_kidney_camera: Array, points_camera: Array) -> NDArray[np.int32]:
        return np.rint(self.project(apply(T_kidney_camera, points_camera))).astype(np.int32)


def draw_overview(kidney: Kidney, side_px: int = 360, from_side: bool = False, names: bool = True) -> Overview:
    """A kidney seen across its flattest direction, or from the side; its calyces are named at their tips if asked."""
    T = standpoint(kidney.mesh, from_side)
    extent = np.abs(apply(T, kidney.mesh.vertices)[:, :2]).max()
    overview = Overview(np.full((side_px, side_px, 3), 255, np.uint8), T, 0.46 * side_px / float(extent))
    picture = _translucent(kidney.mesh, overview)
    for calyx, at in zip(kidney.calyces, overview.project(kidney.tips_mm), strict=True) if names else ():
        x, y = np.rint(at).astype(int).tolist()
        cv2.circle(picture, (x, y), 2, _INK, -1, cv2.LINE_AA)
        cv2.putText(picture, calyx.name, (x + 4, y - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, _INK, 1, cv2.LINE_AA)
    return Overview(picture, T, overview.px_per_mm)


def standpoint(mesh: trimesh.Trimesh, from_side: bool) -> Array:
    """T_view_kidney (4, 4): the kidney's longest direction upright, its flattest one (or the middle one) away."""
    center = mesh.vertices.mean(axis=0)
    _, _, axes = np.linalg.svd(np.asarray(mesh.vertices - center), full_matrices=False)
    down = -axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
    away = axes[1] if from_side else axes[2]
    away = away * np.sign(away[np.argmax(np.abs(away))])
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(down, away), down, away])
    T[:3, 3] = -T[:3, :3] @ center
    return T


def _translucent(mesh: trimesh.Trimesh, overview: Overview, layers: int = 8) -> Picture:
    """Walls laid over each other from back to front, denser where seen at a slant."""
    side = overview.picture.shape[0]
    R, t = overview.T_view_kidney[:3, :3], overview.T_view_kidney[:3, 3]
    scene = RayScene(mesh)
    grid = (
        np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) - (side - 1) / 2
    ) / overview.px_per_mm
    origin = (np.column_stack([grid, np.full(len(grid), -1e3)]) - t) @ R
    away = np.broadcast_to(R[2], origin.shape)
    through = np.ones(len(grid))
    color = np.zeros((len(grid), 3))
    for _ in range(layers):
        depth, normals = scene.cast(origin, away)
        hit = np.isfinite(depth)
        facing = np.abs(normals @ R[2])
        opacity = np.where(hit, 0.10 + 0.55 * (1 - facing) ** 2, 0.0)
        color += (through * opacity)[:, None] * _TISSUE * (0.45 + 0.55 * facing)[:, None]
        through *= 1 - opacity
        origin = np.where(hit[:, None], origin + (depth + 1e-2)[:, None] * away, origin)
        if not hit.any():
            break
        origin[~hit] = 1e6
    return np.clip(color + through[:, None] * 255, 0, 255).astype(np.uint8).reshape(side, side, 3)
