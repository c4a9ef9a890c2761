"""The lens: a calibration that is off, defocus, motion blur, vignetting, halo, bloom, veil, interference stripes.

Lengths in px are those of a picture 250 px wide (the thesis's camera) and grow with the picture.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Mask, lens_rays

REFERENCE_WIDTH_PX = 250


@dataclass(frozen=True, slots=True)
class OpticsFaults:
    """What the lens and stray light do to the picture."""

    lens_scale: float = setting(0.0, -0.05, 0.05, "relative error of the calibrated focal length")
    center_px: float = setting(0.0, 0, 6, "error of the calibrated principal point")
    center_angle_rad: float = choice(0.0, "direction of that error")
    defocus_px: float = setting(
        0.0, 0, 4, "standard deviation of the blur; a fixed-focus 1 mm camera is sharp from about 3-50 mm"
    )
    motion_px: float = setting(
        0.0, 0, 20, "length of the motion blur: 10 mm/s past a wall at 8 mm and 1/30 s exposure is about 4 px"
    )
    motion_rad: float = choice(0.0, "direction of the motion in the picture")
    vignetting: float = setting(0.0, 0, 0.7, "share of light lost at the rim; cos^4 of 40 degrees in the glass is 0.65")
    halo: float = setting(
        0.0, 0, 0.6, "picture value that stray LED light adds at its brightest (thesis 6.2.1: 'halo')"
    )
    halo_radius: float = choice(0.9, "where its center lies towards the LED, in image radii; 0.4-1.3")
    halo_size: float = choice(0.35, "standard deviation of the halo, in image radii; 0.15-0.7")
    halo_angle_rad: float = choice(0.0, "around the image center, from x towards y")
    bloom: float = setting(0.0, 0, 0.5, "share of light that scatters widely around bright spots")
    veil: float = setting(0.0, 0, 0.8, "share of the contrast lost to stray light (thesis 6.2.1: low contrast)")
    stripes: float = setting(
        0.0, 0, 25, "amplitude of horizontal interference stripes in gray values of 255 (thesis 4.3.1, 6.2.1)"
    )
    stripe_period_px: float = choice(7.0, "from stripe to stripe; 3-25 px")
    stripe_tilt_rad: float = choice(0.0, "of the stripes against the rows; within 0.1")

    def __post_init__(self) -> None:
        check_settings(self)


def through_lens(picture: Floats, mask: Mask, camera: Camera, faults: OpticsFaults, rng: np.random.Generator) -> Floats:
    """The picture (H, W, 3), values about 0..1, as it falls on the sensor; ``rng`` draws the stripes' phase."""
    unit = camera.width / REFERENCE_WIDTH_PX
    if faults.lens_scale or faults.center_px:
        picture = _miscalibrated(picture, camera, faults, unit)
    if faults.motion_px * unit > 0.5:
        kernel = _motion_kernel(faults.motion_px * unit, faults.motion_rad)
        picture = _blurred(picture, mask, lambda a: cv2.filter2D(a, -1, kernel))
    if faults.defocus_px > 0.05:
        sigma = faults.defocus_px * unit
        picture = _blurred(picture, mask, lambda a: cv2.GaussianBlur(a, (0, 0), sigma))
    picture = _stray_light(picture, mask, camera, faults, unit)
    x, y, radius = image_circle(camera)
    if faults.vignetting > 0:
        loss = np.float32(faults.vignetting) * np.square((x * x + y * y) / np.float32(radius**2))
        picture = np.asarray(picture * (1 - loss)[..., None], np.float32)
    if faults.stripes > 0:
        picture = picture + _stripes(x, y, unit, faults, rng)[..., None]
    return picture


def _stray_light(picture: Floats, mask: Mask, camera: Camera, faults: OpticsFaults, unit: float) -> Floats:
    """Bloom, veil and halo."""
    if faults.bloom > 0:
        bloomed = picture + np.float32(faults.bloom) * _wide_blur(picture, 12 * unit)
        picture = np.asarray(bloomed / (1 + faults.bloom), np.float32)
    if faults.veil > 0 and mask.any():
        share = np.float32(faults.veil)
        picture = picture * (1 - share) + share * picture[mask].mean()
    if faults.halo > 0:
        x, y, radius = image_circle(camera)
        u0, v0 = faults.halo_radius * np.cos(faults.halo_angle_rad), faults.halo_radius * np.sin(faults.halo_angle_rad)
        away2 = np.square(x / radius - np.float32(u0)) + np.square(y / radius - np.float32(v0))
        picture = picture + np.float32(faults.halo) * np.exp(-away2 / np.float32(2 * faults.halo_size**2))[..., None]
    return picture


def _miscalibrated(picture: Floats, camera: Camera, faults: OpticsFaults, unit: float) -> Floats:
    """The same wall through a lens whose scale and center are off what ``camera`` says."""
    shift = faults.center_px * unit * np.array([np.cos(faults.center_angle_rad), np.sin(faults.center_angle_rad)])
    v, u = np.indices(picture.shape[:2], np.float32)
    source_u = (u - camera.cx - shift[0]) / (1 + faults.lens_scale) + camera.cx
    source_v = (v - camera.cy - shift[1]) / (1 + faults.lens_scale) + camera.cy
    filled = _filled_outside(picture, camera)
    return cv2.remap(filled, source_u.astype(np.float32), source_v.astype(np.float32), cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_REPLICATE)  # fmt: skip


def _filled_outside(picture: Floats, camera: Camera) -> Floats:
    """The picture continued beyond the image circle by its mirror image, so that a shifted rim shows wall."""
    _, mask = lens_rays(camera)
    if mask.all():
        return picture
    x, y, radius = image_circle(camera)
    r = np.maximum(np.hypot(x, y), 1e-3)
    back = np.where(mask, 1, np.clip((2 * (radius - 1) - r) / r, 0, 1)).astype(np.float32)
    map_x, map_y = np.float32(camera.cx) + x * back, np.float32(camera.cy) + y * back
    return cv2.remap(picture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _blurred(picture: Floats, mask: Mask, blur: Callable[[Floats], Floats]) -> Floats:
    """Blur that takes nothing from the black outside of the image circle."""
    weight = np.maximum(blur(mask.astype(np.float32)), 1e-3)
    return np.asarray(blur(picture * mask[..., None]) / weight[..., None], np.float32)


def _motion_kernel(length_px: float, angle_rad: float) -> Floats:
    half = int(np.ceil(length_px / 2)) + 1
    kernel = np.zeros((2 * half + 1,) * 2, np.float32)
    for s in np.linspace(-length_px / 2, length_px / 2, 8 * half):
        u, v = half + s * np.cos(angle_rad), half + s * np.sin(angle_rad)
        i, j = int(v), int(u)
        kernel[i : i + 2, j : j + 2] += np.outer([1 - v + i, v - i], [1 - u + j, u - j])
    return kernel / kernel.sum()


def _wide_blur(picture: Floats, sigma_px: float) -> Floats:
    height, width = picture.shape[:2]
    small = cv2.resize(picture, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    return cv2.resize(cv2.GaussianBlur(small, (0, 0), sigma_px / 4), (width, height), interpolation=cv2.INTER_LINEAR)


@lru_cache(maxsize=8)
def image_circle(camera: Camera) -> tuple[Floats, Floats, float]:
    """Pixel coordinates x, y (H, W) from the principal point, and how far the picture reaches from it, in px."""
    v, u = np.indices((camera.height, camera.width), np.float32)
    x, y = u - np.float32(camera.cx), v - np.float32(camera.cy)
    mask = lens_rays(camera)[1]
    return x, y, float(np.hypot(x, y)[mask].max(initial=1.0))


def _stripes(x: Floats, y: Floats, unit: float, faults: OpticsFaults, rng: np.random.Generator) -> Floats:
    """Nearly horizontal sinusoidal stripes, stronger in one part of the picture, slightly wavy."""
    phase, wobble, place = rng.uniform(0, 2 * np.pi, 3)
    across = y * np.cos(faults.stripe_tilt_rad) + x * np.sin(faults.stripe_tilt_rad)
    cycles = across / (faults.stripe_period_px * unit)
    half_height = y.shape[0] / 2
    strength = 1 + 0.4 * np.sin(2 * y / half_height + place)
    wave = np.sin(2 * np.pi * cycles + phase + 0.3 * np.sin(3 * y / half_height + wobble))
    return np.asarray(faults.stripes / 255 * strength * wave, np.float32)
