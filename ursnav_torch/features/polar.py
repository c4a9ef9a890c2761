"""Polar maps: a picture sampled on rings around the optical axis, where a roll of the scope is a shift.

Correlating two maps over that shift by FFT compares two pictures at every roll at once.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.camera import Camera


@dataclass(frozen=True, slots=True)
class PolarGrid:
    """Where the rings lie in a picture.

    Attributes:
        grid: (R, A, 2) sampling places in `torch.nn.functional.grid_sample`'s units (align_corners=False).
        tangent: (R, A) complex, unit direction that leads outward there (x + iy).
        weight: (R, 1) share of the picture's area that a sample of the ring stands for; sums to 1 over all samples.
    """

    grid: Tensor
    outward: Tensor
    weight: Tensor


def polar_grid(camera: Camera, rings: int = 20, sectors: int = 72, reach: float = 0.93) -> PolarGrid:
    """Rings evenly spaced in angle from the optical axis out to ``reach`` of the picture's inscribed circle."""
    edge = min(camera.cx, camera.cy, camera.width - 1 - camera.cx, camera.height - 1 - camera.cy)
    side = camera.rays(np.array([camera.cx + edge, camera.cy]))[0]
    theta_max = float(np.arctan2(np.hypot(side[0], side[1]), side[2]))
    if camera.fov_deg is not None:
        theta_max = min(theta_max, np.radians(camera.fov_deg) / 2)
    theta = (np.arange(rings) + 0.5) / rings * theta_max * reach
    phi = np.arange(sectors) / sectors * 2 * np.pi
    ray = np.stack(
        [
            np.sin(theta)[:, None] * np.cos(phi),
            np.sin(theta)[:, None] * np.sin(phi),
            np.broadcast_to(np.cos(theta)[:, None], (rings, sectors)),
        ],
        axis=-1,
    )
    pixels, _ = camera.project(ray)
    unit = (2 * pixels + 1) / np.array([camera.width, camera.height]) - 1
    outward = np.broadcast_to(np.exp(1j * phi), (rings, sectors)).copy()
    weight = np.sin(theta)[:, None]
    return PolarGrid(
        torch.from_numpy(unit).float(),
        torch.from_numpy(outward).to(torch.complex64),
        torch.from_numpy(weight / (weight.sum() * sectors)).float(),
    )


def sample(fields: Tensor, polar: PolarGrid) -> Tensor:
    """Fields (C, H, W) on the rings: (C, R, A)."""
    grid = polar.grid[None]
    return torch.nn.functional.grid_sample(fields[None], grid, align_corners=False, padding_mode="border")[0]


def relief_map(relief: Tensor, polar: PolarGrid) -> Tensor:
    """Polar map (1, R, A) of a relief (H, W): zero mean, unit length, area-weighted."""
    return unit_length(centered(sample(relief[None], polar), polar) * polar.weight.sqrt())


def gradient_map(gradient: Tensor, polar: PolarGrid, softness: float = 0.9) -> Tensor:
    """Polar map (2, R, A) of edge directions, from the gradient (2, H, W) (d/dx, d/dy).

    The gradient's angle to the outward direction is doubled, so that bright-to-dark and dark-to-bright are one
    (an edge has no sign), and its strength saturates at ``softness`` times the picture's median: a normalized
    gradient field (Haber and Modersitzki, MICCAI 2006), which no change of contrast alters.
    """
    x, y = sample(gradient, polar)
    z = torch.complex(x, y) * polar.outward.conj()
    strength = z.abs()
    half = softness * strength.median() + 1e-9
    doubled = z * z / (strength * strength + half * half) * polar.weight.sqrt()
    return unit_length(torch.stack([doubled.real, doubled.imag]))


def centered(field: Tensor, polar: PolarGrid) -> Tensor:
    """A polar field (C, R, A) less its area-weighted mean."""
    return field - (field * polar.weight).sum((1, 2), keepdim=True)


def unit_length(field: Tensor) -> Tensor:
    """A field scaled to Euclidean length 1; a field of nothing stays zero."""
    return field / field.norm().clamp_min(1e-9)
