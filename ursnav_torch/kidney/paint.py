"""Surfaces drawn into a picture without any renderer: triangles from the farthest to the nearest, lit from the eye."""

import cv2
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.geometry import apply

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: How much darker the farthest is than the nearest, so that steps show in a face seen straight on.
_FOG = 0.6


def paint_surface(
    picture: Picture, mesh: trimesh.Trimesh, T_view_mesh: Array, px_per_mm: float, color_bgr: ArrayLike
) -> None:
    """Draw a mesh into ``picture`` (H, W, 3), in place.

    ``T_view_mesh`` (4, 4) gives x to the right, y down and z away from the eye, mm, from the picture's middle.
    """
    color = np.asarray(color_bgr, float)
    middle = (np.array(picture.shape[1::-1]) - 1) / 2
    triangles = apply(T_view_mesh, mesh.triangles)
    normals = mesh.face_normals @ T_view_mesh[:3, :3].T
    front = np.flatnonzero(normals[:, 2] < 0)
    pixels = np.rint(triangles[..., :2] * px_per_mm + middle).astype(np.int32)
    depth = triangles[:, :, 2].mean(axis=1)
    fog = 1 - _FOG * (depth - depth.min()) / max(float(np.ptp(depth)), 1e-9)
    shade = fog * (0.25 + 0.75 * np.clip(-normals[:, 2], 0, 1))
    for face in front[np.argsort(-depth[front], kind="stable")]:
        cv2.fillConvexPoly(picture, pixels[face], (color * shade[face]).tolist())


def write_lines(picture: Picture, lines: list[str], at: tuple[int, int] = (8, 20)) -> None:
    """Write lines of text into a picture (H, W, 3), in place; ``at`` (x, y) is where the first starts."""
    for i, line in enumerate(lines):
        text = line.encode("ascii", "replace").decode()
        place = (at[0], at[1] + 20 * i)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
