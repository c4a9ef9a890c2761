"""Can a lens be? A calibration of another picture, or one that folds, is refused before anything is drawn."""

import math
import warnings

import numpy as np

from ursnav_torch.camera.lens import Camera
from ursnav_torch.errors import InputError

#: Fields of view of scopes and cameras, full angle across the picture's longer middle line, degrees; a flat
#: picture plane has less.
_FOV_DEG, _FLAT_FOV_DEG = (10.0, 300.0), (10.0, 150.0)
_ASPECT = (0.5, 2.0)
#: How far a principal point is off the middle, of the picture's side: more than most lenses are, and none any more
#: (chosen by ``benchmarks.endocal.lens_sense``: 0.095 and 0.333).
FAR_OFF, AT_THE_RIM = 0.095, 0.35
#: An image circle is no narrower than this part of the picture's shorter side, and does not lie around all of the
#: picture at so many times its farthest corner.
_CIRCLE = 0.4, 1.2
#: Pixels project back onto themselves within this, px.
_ROUND_TRIP_PX = 0.01


def check_sense(lens: Camera, where: str) -> None:
    """Refuse a lens that cannot have taken its picture.

    Raises:
        InputError: its principal point is outside the picture, its pixels are no squares, its field of view is none, it
            folds inside the picture, or pixels do not project back onto themselves.
    """
    if not (-0.5 <= lens.cx <= lens.width - 0.5 and -0.5 <= lens.cy <= lens.height - 0.5):
        raise InputError(
            f"The lens in {where} has its principal point at ({lens.cx:.1f}, {lens.cy:.1f}), outside its picture of "
            f"{lens.width} x {lens.height} px: is it the calibration of another resolution? If pictures were cropped, "
            "give the whole picture's calibration and camera.crop=[x,y,w,h]."
        )
    _check_middle(lens, where)
    if not _ASPECT[0] < lens.fx / lens.fy < _ASPECT[1]:
        raise InputError(f"The lens in {where} has fx {lens.fx:g} and fy {lens.fy:g}, which no square pixels give.")
    _check_fold(lens, where)
    _check_field(lens, where)
    _check_round_trip(lens, where)


def _check_middle(lens: Camera, where: str) -> None:
    """Refuse a principal point at the picture's rim, and say one that is far off its middle."""
    off = max(abs(lens.cx - (lens.width - 1) / 2) / lens.width, abs(lens.cy - (lens.height - 1) / 2) / lens.height)
    told = (
        f"The lens in {where} has its principal point at ({lens.cx:.1f}, {lens.cy:.1f}), {off:.0%} of its picture of "
        f"{lens.width} x {lens.height} px off the middle: is it the calibration of another resolution, or are row and "
        "column exchanged?"
    )
    if off > AT_THE_RIM:
        raise InputError(f"{told} If pictures were cropped, give the whole one's and camera.crop=[x,y,w,h].")
    if off > FAR_OFF:
        warnings.warn(told, stacklevel=4)


def _check_fold(lens: Camera, where: str) -> None:
    """Refuse an equidistant lens whose radius stops rising before the picture's (or its circle's) rim."""
    fold = lens.fold()
    if fold >= math.pi or (lens.fov_deg is not None and fold >= math.radians(lens.fov_deg) / 2):
        return
    radius = lens.radius_px(fold)
    rim = lens.farthest_px()
    if lens.fov_deg is not None or radius < rim - 0.5:
        raise InputError(
            f"The lens in {where} folds at {math.degrees(fold):.1f} degrees from its axis: no ray reaches beyond "
            f"{radius:.0f} px from the center, but the picture goes to {rim:.0f} px. Calibrate again with the board up "
            "to the rim and fewer coefficients, or give camera.fov_deg= if the scope's picture is a smaller circle."
        )


def _check_field(lens: Camera, where: str) -> None:
    ends = np.array([[0, lens.cy], [lens.width - 1, lens.cy], [lens.cx, 0], [lens.cx, lens.height - 1]])
    rays, _ = lens.rays(ends)
    angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
    if lens.fov_deg is not None and lens.fov_deg < _FOV_DEG[0]:
        raise InputError(f"The lens in {where} has fov_deg={lens.fov_deg:g}: it is the full angle in degrees.")
    _check_circle(lens, where)
    field = float(max(angle[0] + angle[1], angle[2] + angle[3]))
    low, high = _FLAT_FOV_DEG if lens.model in ("pinhole", "rational") else _FOV_DEG
    if not low <= field <= high:
        raise InputError(
            f"The lens in {where} sees {field:.3g} degrees across its picture of {lens.width} x {lens.height} px; "
            f"{low:g} to {high:g} are plausible for {lens.model}. Are fx={lens.fx:g} and fy={lens.fy:g} in px of this "
            "picture, or do they belong to another resolution or unit?"
        )


def _check_circle(lens: Camera, where: str) -> None:
    """Say an image circle that has hardly to do with the picture: it lies around it, or is a spot in it."""
    if lens.fov_deg is None or lens.model != "equidistant":
        return
    circle, shorter = lens.radius_px(min(math.radians(lens.fov_deg) / 2, lens.fold())), min(lens.width, lens.height)
    if circle > _CIRCLE[1] * lens.farthest_px() or 2 * circle < _CIRCLE[0] * shorter:
        warnings.warn(
            f"The lens in {where} has fov_deg={lens.fov_deg:g}, a circle {2 * circle:.0f} px wide in its picture of "
            f"{lens.width} x {lens.height} px: are fx and fy those of another resolution?",
            stacklevel=5,
        )


def _check_round_trip(lens: Camera, where: str) -> None:
    u, v = np.meshgrid(np.linspace(0, lens.width - 1, 40), np.linspace(0, lens.height - 1, 40))
    pixels = np.stack([u, v], axis=-1)
    rays, inside = lens.rays(pixels)
    back, _ = lens.project(rays)
    off = np.where(inside, np.linalg.norm(back - pixels, axis=-1), 0.0)
    lost = ~inside if lens.fov_deg is None and lens.mask is None else np.zeros_like(inside)
    if lens.model != "equidistant" and lost.any():
        worst = np.hypot(pixels[..., 0] - lens.cx, pixels[..., 1] - lens.cy)[lost].min()
        raise InputError(
            f"The lens in {where} is not defined over its whole picture: from {worst:.0f} px off its center on, pixels "
            "have no ray. Calibrate again with the board up to the rim, or give camera.fov_deg= if the scope's "
            "picture is a smaller circle."
        )
    if off.max() > _ROUND_TRIP_PX:
        raise InputError(
            f"The lens in {where} does not project its own pixels back: up to {off.max():.3g} px off. Its coefficients "
            f"k={list(lens.k)} are no calibration."
        )
