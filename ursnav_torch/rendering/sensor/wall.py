"""The wall: its color, the mucosa's mottling and relief, vessels, and the seam of a printed phantom.

All of it is fixed to kidney coordinates, so that it stays in place while the camera moves.
"""

from dataclasses import dataclass

import numpy as np

from ursnav_torch.rendering.sensor.noise import fractal_noise, noise_and_slope, solid_noise
from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Surface

#: The share of blue, green and red light that a layer of blood leaves.
BLOOD_BGR = np.array([0.30, 0.35, 0.85], np.float32)
_SEAM_SPACING_MM = 40.0


@dataclass(frozen=True, slots=True)
class WallFaults:
    """What the wall looks like besides its shape."""

    color_bgr: tuple[float, float, float] = choice(
        (1.0, 1.0, 1.0), "gray values of an evenly lit wall, relative; thesis 4.1 changes the material's color"
    )
    seed: int = choice(0, "which texture, vessels and seam")
    mottle: float = setting(
        0.0,
        0,
        0.6,
        "relative spread of the wall's reflectance; mucosa is patchy, from pale papilla to congested fornix",
    )
    mottle_scale_mm: float = choice(2.0, "size of the patches; 0.5-6 mm")
    relief_mm: float = setting(0.0, 0, 0.35, "height of folds and bumps that a CT of 0.5-1 mm voxels does not show")
    relief_scale_mm: float = choice(2.0, "size of the folds; 0.8-5 mm")
    vessels: float = setting(0.0, 0, 1, "how much darker and redder suburothelial vessels are than their surroundings")
    vessel_width_mm: float = choice(0.2, "width of the vessels; 0.1-0.5 mm")
    vessel_spacing_mm: float = choice(5.0, "typical distance between vessels; 3-10 mm")
    redness: float = setting(0.0, 0, 0.6, "share of light lost to blood in congested patches")
    seam: float = setting(0.0, 0, 1, "darkness of the line where a phantom's printed parts meet (thesis 4)")
    seam_width_mm: float = choice(0.4, "width of the seam; 0.1-1 mm")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class PaintedWall:
    """Reflectance (N, 3) blue, green, red as picture values; bumped unit normals (N, 3); wetness (N,) about 1."""

    color: Floats
    normals: Floats
    wetness: Floats


def paint(surface: Surface, faults: WallFaults) -> PaintedWall:
    """The wall's color, relief and wetness at every seen point."""
    points = surface.points_kidney
    color = np.broadcast_to(np.array(faults.color_bgr, np.float32), points.shape).copy()
    wetness = np.ones(len(points), np.float32)
    if faults.mottle > 0 or faults.redness > 0:
        patches = fractal_noise(points, faults.mottle_scale_mm, faults.seed)
        color *= np.exp(faults.mottle * np.clip(patches, -2.5, 2.5) * 0.5)[:, None]
        congested = faults.redness * _smoothstep(solid_noise(points, 3 * faults.mottle_scale_mm, faults.seed + 20))
        color *= 1 - congested[:, None] * (1 - BLOOD_BGR)
        wetness = np.clip(1 + 0.6 * patches, 0, 2.5)
    if faults.vessels > 0:
        share = faults.vessels * _vessels(points, faults)
        color *= 1 - share[:, None] * (1 - BLOOD_BGR)
    if faults.seam > 0:
        color *= (1 - faults.seam * _seam(points, faults))[:, None]
    return PaintedWall(color, _bumped(surface, faults), wetness)


def _bumped(surface: Surface, faults: WallFaults) -> Floats:
    """Normals tilted by the relief's slope along the wall."""
    if faults.relief_mm == 0:
        return surface.normals
    slope = np.zeros_like(surface.normals)
    for octave in range(2):
        scale = faults.relief_scale_mm / 2**octave
        height = faults.relief_mm / 3**octave
        _, noise_slope = noise_and_slope(surface.points_kidney, scale, faults.seed + 40 + octave)
        slope += np.float32(height / scale) * noise_slope
    slope = slope @ surface.R_kidney_camera
    slope -= np.einsum("ij,ij->i", slope, surface.normals)[:, None] * surface.normals
    bumped = surface.normals - slope
    return bumped / np.sqrt(np.maximum(np.einsum("ij,ij->i", bumped, bumped), 1e-9))[:, None]


def _vessels(points: Floats, faults: WallFaults) -> Floats:
    """0..1: interrupted lines of varying width where a warped noise field crosses zero, |value| / |gradient| away."""
    scale = np.float32(faults.vessel_spacing_mm)
    wiggle, push = noise_and_slope(points, float(scale) / 3, faults.seed + 60)
    field, slope = noise_and_slope(points + np.float32(0.06) * scale * push, float(scale), faults.seed + 61)
    steepness = np.maximum(np.sqrt(np.einsum("ij,ij->i", slope, slope)), 0.3)
    width_mm = np.float32(faults.vessel_width_mm) * (1 + 0.4 * np.clip(wiggle, -1.5, 2))
    present = _smoothstep(0.6 + solid_noise(points, 2 * float(scale), faults.seed + 62))
    return present * np.exp(-np.square(1.3 * np.abs(field) * scale / (steepness * width_mm)))


def _seam(points: Floats, faults: WallFaults) -> Floats:
    """0..1: where the wall meets one of the parallel planes at which the print was parted."""
    rng = np.random.default_rng(faults.seed + 80)
    normal = rng.standard_normal(3)
    along = points @ (normal / np.linalg.norm(normal)).astype(np.float32) / _SEAM_SPACING_MM + rng.random()
    away_mm = _SEAM_SPACING_MM * (along - np.round(along))
    return np.exp(-np.square(2 * away_mm / faults.seam_width_mm)).astype(np.float32)


def _smoothstep(x: Floats) -> Floats:
    """0 below -0.5, 1 above 0.5, smooth between."""
    x = np.clip(x + 0.5, 0, 1)
    return x * x * (3 - 2 * x)
