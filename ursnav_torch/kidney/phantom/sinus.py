"""Where the papillae of a phantom stand around its renal sinus."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Papillae are pushed apart until they are this far from each other, mm.
_APART_MM = 11.5


def draw_papillae(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Papillae (C, 3) from top to bottom on an ellipsoid around the pelvis, and the way out of it there (C, 3).

    One at the top, one at the bottom, and levels between them with one in front, one behind, or both.
    """
    half = np.array([rng.uniform(19, 25), rng.uniform(13, 17), rng.uniform(25, 31)])
    points = half * _spread(_levels(rng, count), half)
    outward = points / half**2
    points = points * rng.uniform(0.88, 1.08, (count, 1)) + np.array([rng.uniform(-1, 3), 0, 0])
    return points, outward / np.linalg.norm(outward, axis=1, keepdims=True)


def _levels(rng: np.random.Generator, count: int) -> Array:
    """(C, 3) directions from the pelvis, from top to bottom."""
    levels = (count + 3) // 2
    members = np.ones(levels, int)
    paired = rng.permutation(np.arange(1, levels - 1))[: count - levels]
    members[paired] = 2
    height = np.linspace(1, -1, levels) * np.radians(rng.uniform(68, 80))
    elevation = np.repeat(height, members) + np.radians(rng.normal(0, 5, count))
    side = np.concatenate([rng.choice([-1, 1]) * np.array([1, -1][:m]) for m in members])
    spread = np.where(np.repeat(members, members) == 2, rng.uniform(35, 68, count), rng.uniform(0, 30, count))
    azimuth = np.radians(spread) * side
    across = np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)


def _spread(unit: Array, half: Array) -> Array:
    """Directions (C, 3), moved so that their points on the ellipsoid stand apart and stay lateral."""
    for _ in range(60):
        points = unit * half
        away = points[:, None] - points
        distance = np.linalg.norm(away, axis=-1) + np.eye(len(unit)) * 1e3
        push = 0.25 * np.maximum(_APART_MM - distance, 0) / distance
        points = points + np.sum(away * push[..., None], axis=1)
        unit = points / half
        unit[:, 0] = np.maximum(unit[:, 0], 0.15)
        unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    return unit
