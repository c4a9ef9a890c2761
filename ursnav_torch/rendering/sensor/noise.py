"""Solid noise: a random scalar field in space, so that texture stays on the wall when the camera moves."""

from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from ursnav_torch.rendering.sensor.surface import Floats

_CELLS = 48
_CELLS_BY_SCALE = 2.5  # from a hill of the volume to the next valley
_VOLUME_SEED = 20


def solid_noise(points_mm: Floats, scale_mm: float, seed: int) -> Floats:
    """Smooth noise (N,) of mean 0 and standard deviation 1 at points (N, 3) in mm.

    Args:
        points_mm: places in the kidney frame.
        scale_mm: the typical distance from a hill of the field to the next valley.
        seed: another seed is another place and direction in one fixed random volume.
    """
    cells, _ = _cells(points_mm, scale_mm, seed)
    return _sampled(cells, _volume()[:, :1])[0]


def noise_and_slope(points_mm: Floats, scale_mm: float, seed: int) -> tuple[Floats, Floats]:
    """`solid_noise` (N,) and its gradient (N, 3) along the kidney frame's axes, times ``scale_mm``."""
    cells, R = _cells(points_mm, scale_mm, seed)
    value, *slope = _sampled(cells, _volume())
    return value, np.stack(slope, axis=1) @ R * np.float32(_CELLS_BY_SCALE)


def fractal_noise(points_mm: Floats, scale_mm: float, seed: int, octaves: int = 2) -> Floats:
    """Noise (N,) of mean 0 and standard deviation 1 with ever finer, ever weaker octaves below ``scale_mm``."""
    total = np.zeros(len(points_mm), np.float32)
    for octave in range(octaves):
        total += np.float32(0.5**octave) * solid_noise(points_mm, scale_mm / 2.5**octave, seed + octave)
    return total / np.float32(np.sqrt(sum(0.25**octave for octave in range(octaves))))


def _cells(points_mm: Floats, scale_mm: float, seed: int) -> tuple[Floats, Floats]:
    """Where in the repeating volume the points lie, in cells (N, 3), and the rotation cells <- kidney (3, 3)."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix().astype(np.float32)
    cells = points_mm @ (R.T * np.float32(_CELLS_BY_SCALE / scale_mm)) + rng.uniform(0, _CELLS, 3).astype(np.float32)
    return cells - _CELLS * np.floor(cells / np.float32(_CELLS)), R


def _sampled(cells: Floats, volume: torch.Tensor) -> NDArray[np.float32]:
    """(C, N): the volume's channels, interpolated."""
    grid = torch.from_numpy(cells * np.float32(2 / _CELLS) - np.float32(1)).view(1, 1, 1, -1, 3)
    sampled = torch.nn.functional.grid_sample(volume, grid, mode="bilinear", align_corners=True)
    return sampled.view(volume.shape[1], -1).numpy()


@lru_cache(maxsize=1)
def _volume() -> torch.Tensor:
    """(1, 4, D, H, W): periodic noise of unit variance and its gradient per cell along x (W), y (H), z (D)."""
    white = np.random.default_rng(_VOLUME_SEED).standard_normal((_CELLS,) * 3)
    orders = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0)]
    fields = np.stack([gaussian_filter(white, 1.2, order=order, mode="wrap") for order in orders])
    fields[0] -= fields[0].mean()
    volume = np.pad(fields / fields[0].std(), ((0, 0), (0, 1), (0, 1), (0, 1)), mode="wrap")
    return torch.from_numpy(volume.astype(np.float32))[None]
