"""What comes between lens and wall: debris, bubbles, blood, a stone, a laser fiber or guidewire."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.sensor.optics import REFERENCE_WIDTH_PX, image_circle
from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Mask
from ursnav_torch.rendering.sensor.wall import BLOOD_BGR


@dataclass(frozen=True, slots=True)
class OccluderFaults:
    """What floats or reaches into the picture. Lengths in px of a picture 250 px wide."""

    debris: int = setting(0, 0, 40, "floating specks: stone dust, cells, clots; bright where near the light, else dark")
    debris_px: float = choice(2.0, "radius of a large speck; 0.7-6 px")
    bubbles: int = setting(0, 0, 40, "air bubbles, seen as bright rings with a glint")
    bubble_px: float = choice(5.0, "radius of a large bubble; 2-20 px")
    blood: float = setting(0.0, 0, 0.8, "share of light that drifting blood takes, in clouds")
    fiber: float = setting(
        0.0,
        0,
        1,
        "how far a laser fiber or guidewire reaches from the rim (0) to the center (1); 0.5 is a quarter of the "
        "screen, the safety distance of Talso et al., J Endourol 30:1269, 2016",
    )
    fiber_angle_rad: float = choice(0.0, "where it enters, around the image center: the working channel's place")
    fiber_px: float = choice(10.0, "its width at the rim; 200-365 µm cores 1-2 mm before a 160 degree lens are 9-32 px")
    fiber_bgr: tuple[float, float, float] = choice((0.8, 0.5, 0.2), "its color: blue jacket, green, clear or steel")
    fiber_rings: bool = choice(False, "a guidewire's dark and bright windings instead of an even jacket")
    stone: float = setting(0.0, 0, 0.8, "radius of a stone in image radii, before the wall")
    stone_bgr: tuple[float, float, float] = choice((0.35, 0.55, 0.65), "color of the stone: yellow, brown, pale")

    def __post_init__(self) -> None:
        check_settings(self)


def occlude(picture: Floats, mask: Mask, camera: Camera, faults: OccluderFaults, rng: np.random.Generator) -> Floats:
    """The lit wall ``picture`` (H, W, 3), values 0..1, behind what is in the way; ``rng`` draws the places."""
    if not mask.any():
        return picture
    picture = picture.copy()
    unit = camera.width / REFERENCE_WIDTH_PX
    level = float(picture[mask].mean())
    if faults.blood > 0:
        _blood(picture, faults.blood, rng)
    if faults.stone > 0:
        _stone(picture, camera, faults, level, rng)
    if faults.fiber > 0:
        _fiber(picture, camera, faults, level, unit)
    for _ in range(faults.debris):
        _speck(picture, mask, faults.debris_px * unit, level, rng)
    for _ in range(faults.bubbles):
        _bubble(picture, mask, faults.bubble_px * unit, level, rng)
    return picture


def _place(mask: Mask, rng: np.random.Generator) -> tuple[float, float]:
    height, width = mask.shape
    for _ in range(8):
        u, v = rng.uniform(0, width - 1), rng.uniform(0, height - 1)
        if mask[int(v), int(u)]:
            break
    return u, v


def _speck(picture: Floats, mask: Mask, radius_px: float, level: float, rng: np.random.Generator) -> None:
    u, v = _place(mask, rng)
    radius, share = radius_px * rng.uniform(0.35, 1), rng.uniform(0.5, 1)
    gray = level * (rng.uniform(1.5, 2.8) if rng.random() < 0.6 else rng.uniform(0.1, 0.5))
    _blend_disk(picture, u, v, 2.5 * radius, gray, lambda r: share * np.exp(-np.square(r / radius)))


def _bubble(picture: Floats, mask: Mask, radius_px: float, level: float, rng: np.random.Generator) -> None:
    """A bright ring around an unchanged middle, with a glint on one side."""
    u, v = _place(mask, rng)
    radius, share = radius_px * rng.uniform(0.4, 1), rng.uniform(0.5, 1)
    thickness, glint, angle = max(0.15 * radius, 0.8), max(0.15 * radius, 0.7), rng.uniform(0, 2 * np.pi)
    gray = min(level * rng.uniform(1.6, 3), 1.1)
    reach = radius + 2.5 * thickness
    _blend_disk(picture, u, v, reach, gray, lambda r: share * np.exp(-np.square((r - radius) / thickness)))
    u, v = u + 0.45 * radius * np.cos(angle), v + 0.45 * radius * np.sin(angle)
    _blend_disk(picture, u, v, 2.5 * glint, gray, lambda r: 0.7 * share * np.exp(-np.square(r / glint)))


def _blend_disk(
    picture: Floats, u: float, v: float, reach_px: float, gray: float, share_at: Callable[[Floats], Floats]
) -> None:
    """Blend ``gray`` into ``picture`` in place around (u, v) with the share that ``share_at(radius in px)`` gives."""
    top, left = max(int(v - reach_px), 0), max(int(u - reach_px), 0)
    patch = picture[top : int(v + reach_px) + 2, left : int(u + reach_px) + 2]
    y, x = np.indices(patch.shape[:2], np.float32)
    share = share_at(np.hypot(x + left - u, y + top - v))[..., None]
    patch += share * (gray - patch)


def _blood(picture: Floats, share: float, rng: np.random.Generator) -> None:
    """Clouds that take blue and green light."""
    height, width = picture.shape[:2]
    coarse = rng.uniform(0, 1, (5, 5)).astype(np.float32)
    cloud = np.clip(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), 0, 1)
    picture *= 1 - share * cloud[..., None] * (1 - BLOOD_BGR)


def _stone(picture: Floats, camera: Camera, faults: OccluderFaults, level: float, rng: np.random.Generator) -> None:
    """An irregular, rough, shaded lump."""
    x, y, radius = image_circle(camera)
    away, angle = rng.uniform(0.2, 0.8) * radius, rng.uniform(0, 2 * np.pi)
    x, y = x - away * np.cos(angle), y - away * np.sin(angle)
    around = np.arctan2(y, x)
    edge = 1 + sum(rng.uniform(-0.25, 0.25) / n * np.cos(n * around + rng.uniform(0, 2 * np.pi)) for n in range(2, 7))
    inside = 1 - np.hypot(x, y) / (faults.stone * radius * edge)
    coarse = rng.uniform(0.6, 1.2, (camera.height // 6 + 1, camera.width // 6 + 1)).astype(np.float32)
    rough = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    bright = 2.2 * level * rough * (0.5 + 0.5 * np.sqrt(np.clip(inside, 0, 1)))
    share = np.clip(inside * faults.stone * radius / 2, 0, 1)[..., None]
    picture += share * (bright[..., None] * np.array(faults.stone_bgr, np.float32) - picture)


def _fiber(picture: Floats, camera: Camera, faults: OccluderFaults, level: float, unit: float) -> None:
    """A cylinder from the rim towards the center, narrower the farther it reaches."""
    x, y, radius = image_circle(camera)
    c, s = np.cos(faults.fiber_angle_rad), np.sin(faults.fiber_angle_rad)
    outward, across = (x * c + y * s) / radius, y * c - x * s
    half_width = faults.fiber_px * unit / 2 * np.clip(0.35 + 0.65 * outward, 0.2, 1.5)
    side = across / half_width
    share = np.clip(half_width - np.abs(across) + 0.5, 0, 1)
    share = share * np.clip((outward - (1 - faults.fiber)) * radius / 1.5 + 0.5, 0, 1)
    shine = 0.55 + 0.45 * np.sqrt(np.clip(1 - side * side, 0, 1))
    if faults.fiber_rings:
        shine = shine * (0.75 + 0.25 * np.sin(2 * np.pi * outward * radius / (0.4 * faults.fiber_px * unit)))
    color = np.array(faults.fiber_bgr, np.float32) * max(1.8 * level, 0.4)
    picture += share[..., None] * (shine[..., None] * color - picture)
