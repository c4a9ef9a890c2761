"""A picture of what will come out of the printer."""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.geometry import apply
from ursnav_torch.kidney.paint import paint_surface, write_lines
from ursnav_torch.printing.phantom import PrintedPhantom
from ursnav_torch.printing.solid import frame_along

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_SIDE_PX = 560
_FIRST, _SECOND, _DOT = (130, 195, 240), (215, 190, 140), (60, 60, 255)


def print_picture(phantom: PrintedPhantom) -> Picture:
    """(H, W, 3) uint8, blue green red: both halves pulled apart and seen from the side, then each cut face."""
    center = phantom.shell.bounds.mean(axis=0)
    scale = 1.1 * _SIDE_PX / float(np.linalg.norm(phantom.shell.extents))
    normal = phantom.cut.normal
    aside = _view(frame_along(normal)[:, 0], normal, center)
    apart = _panel("pulled apart, landmarks L1, L2, ... on the outside")
    for half, sign, color in ((0, 1, _FIRST), (1, -1, _SECOND)):
        moved = _fine(phantom.halves[half])
        moved.apply_translation(sign * 8.0 * normal)
        paint_surface(apart, moved, aside, scale, color)
    _mark(apart, phantom, aside, scale)
    faces = []
    for half, sign, color in ((0, 1, _FIRST), (1, -1, _SECOND)):
        panel = _panel(f"half {'AB'[half]}, onto its cut face")
        view = _view(sign * normal, frame_along(normal)[:, 0], center)
        paint_surface(panel, _fine(phantom.halves[half]), view, scale, color)
        faces.append(panel)
    return np.asarray(np.hstack([apart, *faces]), np.uint8)


def _fine(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Triangles small enough to be drawn in order of their distance."""
    return trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 1.5, 30), process=False)


def _panel(title: str) -> Picture:
    panel = np.full((_SIDE_PX, _SIDE_PX, 3), 24, np.uint8)
    write_lines(panel, [title])
    return panel


def _view(along: Array, up: Array, center: Array) -> Array:
    """(4, 4) kidney to view coordinates for an eye that looks along a direction, with ``up`` upward."""
    z = along / np.linalg.norm(along)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ center
    return T


def _mark(picture: Picture, phantom: PrintedPhantom, view: Array, scale: float) -> None:
    """Name the landmarks that can be seen."""
    middle = (_SIDE_PX - 1) / 2
    towards = np.tile(-view[2, :3], (len(phantom.landmarks_mm), 1))
    hidden = _blocked(phantom.shell, phantom.landmarks_mm + 3.0 * towards, towards)
    for number, (point, no) in enumerate(zip(phantom.landmarks_mm, hidden, strict=True)):
        side = np.sign(point @ phantom.cut.normal - phantom.cut.offset_mm)
        x, y, _ = apply(view, point + side * 8.0 * phantom.cut.normal) * scale + middle
        if not no:
            cv2.circle(picture, (round(x), round(y)), 4, _DOT, -1, cv2.LINE_AA)
            write_lines(picture, [f"L{number + 1}"], (round(x) + 6, round(y) - 4))


def _blocked(mesh: trimesh.Trimesh, start: Array, towards: Array) -> NDArray[np.bool_]:
    return np.asarray(mesh.ray.intersects_any(start, towards))
