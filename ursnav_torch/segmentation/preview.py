"""A picture to accept or reject a segmentation by: where it lies in the body, slices with its outline, its shape."""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.geometry import apply, inverse
from ursnav_torch.kidney.anatomy import Calyx
from ursnav_torch.kidney.paint import paint_surface, write_lines
from ursnav_torch.segmentation.load import CtKidney
from ursnav_torch.segmentation.scans.scan import Scan

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_SIDE_PX = 440
_OUTLINE, _INK, _SURFACE = (60, 60, 255), (255, 255, 255), (120, 190, 240)
#: Image axes (right, down) of each view, and the axis along which it looks: patient right is on the left of a picture.
_VIEWS = {
    "axial": ((0, 1.0), (1, 1.0), 2),
    "coronal": ((0, 1.0), (2, -1.0), 1),
    "sagittal": ((1, 1.0), (2, -1.0), 0),
}


def preview(found: CtKidney, calyces: tuple[Calyx, ...] = ()) -> Picture:
    """(H, W, 3) uint8, blue green red: the whole scan from the front, three slices, and the surface from the front."""
    around = _around(found)
    panels = [_whole(found)]
    panels += [_slice(found, around, name) for name in _VIEWS]
    panels.append(_shape(found, calyces))
    blank = np.full_like(panels[0], 24)
    write_lines(blank, [found.scan.source[:44], *(f"{k}: {v}"[:44] for k, v in found.lumen.about.items())])
    rows = [np.hstack(panels[:3]), np.hstack([*panels[3:], blank])]
    return np.asarray(np.vstack(rows), np.uint8)


def _around(found: CtKidney) -> tuple[Array, float]:
    """Middle of the lumen (3,), LPS, and half the width of a picture around it, mm."""
    points = apply(inverse(found.T_kidney_lps), found.mesh.vertices)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float((high - low).max() / 2 + 12)


def _plane(center: Array, half_mm: float, name: str) -> Array:
    """(S, S, 3) points of a slice through ``center``, LPS."""
    (right, right_sign), (down, down_sign), _ = _VIEWS[name]
    at = np.linspace(-half_mm, half_mm, _SIDE_PX)
    points = np.broadcast_to(center, (_SIDE_PX, _SIDE_PX, 3)).copy()
    points[..., right] += right_sign * at[None, :]
    points[..., down] += down_sign * at[:, None]
    return points


def _slice(found: CtKidney, around: tuple[Array, float], name: str) -> Picture:
    """A slice through the thickest place of the lumen with its outline."""
    center, half = around
    part, lumen = found.lumen.part, found.lumen
    deepest = part.to_lps(np.unravel_index(np.argmax(np.where(lumen.mask, lumen.field, -9)), lumen.mask.shape))
    through = center.copy()
    axis = _VIEWS[name][2]
    through[axis] = deepest[axis]
    points = _plane(through, half, name)
    gray = _gray(_sampled(found.scan, points, outside=-1024), lumen.binary)
    picture = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    inside = _sampled(Scan(lumen.field, part.T_lps_voxel, ""), points, outside=-1) > 0
    contours = cv2.findContours(inside.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)[0]
    cv2.drawContours(picture, contours, -1, _OUTLINE, 1, cv2.LINE_AA)
    write_lines(picture, [f"{name}, {'xyz'[axis]} = {through[axis]:.1f} mm LPS"])
    return np.asarray(picture, np.uint8)


def _sampled(scan: Scan, points: Array, outside: float) -> NDArray[np.float32]:
    """Nearest voxel's value at points (..., 3), LPS."""
    at = np.rint(scan.to_voxel(points)).astype(int)
    there = np.all((at >= 0) & (at < scan.voxels.shape), axis=-1)
    at = np.clip(at, 0, np.array(scan.voxels.shape) - 1)
    return np.where(there, scan.voxels[at[..., 0], at[..., 1], at[..., 2]], outside).astype(np.float32)


def _gray(values: NDArray[np.float32], binary: bool) -> Picture:
    low, high = (0.0, max(float(values.max()), 1.0)) if binary else (-160.0, 700.0)
    return (np.clip((values - low) / (high - low), 0, 1) * 255).astype(np.uint8)


def _whole(found: CtKidney) -> Picture:
    """The densest along the way through the whole scan, from the front, with the lumen in color."""
    scan = found.scan
    step = np.maximum(np.rint(2.0 / scan.spacing_mm), 1).astype(int)
    thin = scan.voxels[:: step[0], :: step[1], :: step[2]]
    axis = int(np.abs(scan.T_lps_voxel[1, :3] / scan.spacing_mm).argmax())
    corners = scan.to_lps(np.array(list(np.ndindex(2, 2, 2))) * (np.array(scan.voxels.shape) - 1))
    center, half = corners.mean(axis=0), float(np.ptp(corners, axis=0)[[0, 2]].max() / 2)
    flat = np.expand_dims(thin.max(axis=axis), axis).astype(np.float32)
    T = scan.T_lps_voxel @ np.diag([*step.astype(float), 1.0])
    points = _plane(center, half, "coronal")
    at = np.rint(apply(np.linalg.inv(T), points)).astype(int)
    at[..., axis] = 0
    there = np.all((at >= 0) & (at < flat.shape), axis=-1)
    at = np.clip(at, 0, np.array(flat.shape) - 1)
    gray = _gray(np.where(there, flat[at[..., 0], at[..., 1], at[..., 2]], -1024.0), found.lumen.binary)
    picture = cv2.cvtColor((gray * 0.7).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    lumen = apply(inverse(found.T_kidney_lps), found.mesh.vertices) - center
    x, y = ((sign * lumen[:, k] + half) / (2 * half) * (_SIDE_PX - 1) for k, sign in ((0, 1.0), (2, -1.0)))
    picture[np.clip(np.rint(y), 0, _SIDE_PX - 1).astype(int), np.clip(np.rint(x), 0, _SIDE_PX - 1).astype(int)] = (
        _OUTLINE
    )
    write_lines(picture, ["whole scan from the front", "R"])
    write_lines(picture[:, -24:], ["", "L"])
    return np.asarray(picture, np.uint8)


def _shape(found: CtKidney, calyces: tuple[Calyx, ...]) -> Picture:
    """The surface from the front, lit from there, with the calyces' names."""
    center, half = _around(found)
    T_lps_kidney = inverse(found.T_kidney_lps)
    mesh = trimesh.Trimesh(apply(T_lps_kidney, found.mesh.vertices), found.mesh.faces, process=False)
    scale = (_SIDE_PX - 1) / (2 * half)
    picture = np.full((_SIDE_PX, _SIDE_PX, 3), 24, np.uint8)
    T_view_lps = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # from the front
    T_view_lps[:3, 3] = -T_view_lps[:3, :3] @ center
    paint_surface(picture, mesh, T_view_lps, scale, _SURFACE)
    for calyx in calyces:
        x, _, z = apply(T_lps_kidney, calyx.tip_mm) - center
        at = (int((x + half) * scale), int((half - z) * scale))
        cv2.circle(picture, at, 4, _OUTLINE, -1, cv2.LINE_AA)
        cv2.putText(picture, calyx.name, (at[0] + 6, at[1] - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)
    write_lines(picture, [f"surface from the front, {found.mesh.volume / 1000:.2f} mL"])
    return picture
