"""Polar maps: a picture sampled on rings around the optical axis, where a roll of the scope is a shift.

Correlating two maps over that shift by FFT compares two pictures at every roll at once.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera


@dataclass(frozen=True, slots=True)
class PolarGrid:
    """Where the rings lie in a picture; N grids, one for each of N tilted cameras.

    Attributes:
        grid: (N, R, A, 2) sampling places in `torch.nn.functional.grid_sample`'s units (align_corners=False).
        outward: (N, R, A) complex, the unit direction in the picture that leads outward there (x + iy).
        inside: (N, R, A) 1.0 where the sample lies in the picture.
        weight: (R, 1) share of the picture's area that a sample of the ring stands for; sums to 1 over all samples.
    """

    grid: Tensor
    outward: Tensor
    inside: Tensor
    weight: Tensor


def polar_grid(
    camera: Camera, R_camera_tilted: NDArray[np.float64] | None = None, rings: int = 20, sectors: int = 72,
    reach: float = 0.93,
) -> PolarGrid:  # fmt: skip
    """Rings evenly spaced in angle from the optical axis out to ``reach`` of the picture's inscribed circle.

    Args:
        camera: the picture's lens.
        R_camera_tilted: (N, 3, 3) cameras at the same place that look elsewhere: a ray r of theirs is ``R @ r`` here.
            Their rings are laid over this picture, which shows what they would see; turning needs no depth.
        rings, sectors: of the map.
        reach: share of the inscribed circle.
    """
    R = np.eye(3)[None] if R_camera_tilted is None else np.asarray(R_camera_tilted, float)
    edge = min(camera.cx, camera.cy, camera.width - 1 - camera.cx, camera.height - 1 - camera.cy)
    side = camera.rays(np.array([camera.cx + edge, camera.cy]))[0]
    theta_max = float(np.arctan2(np.hypot(side[0], side[1]), side[2]))
    if camera.fov_deg is not None:
        theta_max = min(theta_max, np.radians(camera.fov_deg) / 2)
    theta = (np.arange(rings) + 0.5)[:, None] / rings * theta_max * reach
    phi = np.arange(sectors)[None] / sectors * 2 * np.pi
    pixels, inside = camera.project(_turned(_rays(theta, phi), R))
    farther, _ = camera.project(_turned(_rays(theta + 1e-3, phi), R))
    out = farther - pixels
    outward = (out[..., 0] + 1j * out[..., 1]) / np.maximum(np.linalg.norm(out, axis=-1), 1e-12)
    unit = (2 * pixels + 1) / np.array([camera.width, camera.height]) - 1
    weight = np.sin(theta)
    return PolarGrid(
        torch.from_numpy(unit).float(),
        torch.from_numpy(outward).to(torch.complex64),
        torch.from_numpy(inside).float(),
        torch.from_numpy(weight / (weight.sum() * sectors)).float(),
    )


def polar_maps(fields: Tensor, polar: PolarGrid, valid: Tensor | None = None) -> Tensor:
    """Polar maps (N, C, R, A) of a picture's fields (C, H, W): relief, then pairs of gradient d/dx, d/dy.

    Where ``valid`` (N, R, A), see `polar_valid`, is below 1 they count less, and where it is 0 they are 0.

    The relief has zero mean and unit length. A gradient's angle to the outward direction is doubled, so that
    bright-to-dark and dark-to-bright are one (an edge has no sign), and its strength saturates near the picture's
    median: a normalized gradient field (Haber and Modersitzki, MICCAI 2006), which no change of contrast alters; each
    pair has unit length.
    """
    n, channels = len(polar.grid), len(fields)
    sampled = _sampled(fields, polar).view(channels, n, *polar.grid.shape[1:3]).transpose(0, 1)
    counts = (polar.inside if valid is None else valid)[:, None]
    sampled = sampled * polar.inside[:, None]
    maps = torch.empty(sampled.shape)
    maps[:, :1] = _relief(sampled[:, :1], polar.weight, counts)
    for c in range(1, channels, 2):
        _directions(sampled[:, c : c + 2], polar, counts[:, 0], maps[:, c : c + 2])
    return maps


def polar_valid(valid: Tensor, polar: PolarGrid) -> Tensor:
    """How much of each sample (N, R, A) is valid, from the picture's own (H, W); 0 beyond the picture."""
    return _sampled(valid[None], polar).view(polar.inside.shape) * polar.inside


def _sampled(fields: Tensor, polar: PolarGrid) -> Tensor:
    """Fields (C, H, W) at all places of a grid, (C, N R, A)."""
    flat = polar.grid.reshape(1, -1, *polar.grid.shape[2:])
    return torch.nn.functional.grid_sample(fields[None], flat, align_corners=False, padding_mode="zeros")[0]


def _rays(theta: NDArray[np.float64], phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit rays (R, A, 3) at angles theta (R, 1) from the axis and phi (1, A) around it."""
    sin, cos = np.sin(theta), np.cos(theta) + 0 * phi
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def _turned(rays: NDArray[np.float64], R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rays (R, A, 3) turned by each of N rotations: (N, R, A, 3)."""
    return np.einsum("nij,raj->nrai", R, rays)


def _relief(relief: Tensor, weight: Tensor, counts: Tensor) -> Tensor:
    area = weight * counts
    mean = (relief * area).sum((2, 3), keepdim=True) / area.sum((2, 3), keepdim=True).clamp_min(1e-9)
    return _unit_length((relief - mean) * counts * weight.sqrt())


def _directions(gradient: Tensor, polar: PolarGrid, counts: Tensor, out: Tensor, softness: float = 0.9) -> None:
    """One pair of `polar_maps` (N, 2, R, A), into ``out``, where places count (N, R, A): its own length at every place
    is known beforehand, so that it is brought to unit length in the same pass."""
    across, along = torch.view_as_real(polar.outward).unbind(-1)
    x, y = gradient[:, 0], gradient[:, 1]
    outward, around = (x * across).addcmul_(y, along), (y * across).addcmul_(x, along, value=-1)
    square_out, square_around = outward.square(), around.square()
    strength = square_out + square_around
    half = softness * strength[0].median().sqrt() + 1e-9
    share = polar.weight.sqrt() * counts / (strength + half * half)
    share /= _length(strength * share)
    torch.mul(square_out.sub_(square_around), share, out=out[:, 0])
    torch.mul(outward.mul_(around), share.mul_(2), out=out[:, 1])


def _unit_length(field: Tensor) -> Tensor:
    """Fields (N, c, R, A) each scaled to Euclidean length 1; a field of nothing stays zero."""
    return field / _length(field)[..., None]


def _length(field: Tensor) -> Tensor:
    """Euclidean lengths (N, 1, 1) of fields (N, ...), no less than 1e-9."""
    return field.flatten(1).norm(dim=1).clamp_min(1e-9)[:, None, None]
