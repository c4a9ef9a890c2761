"""Shapes drawn in code for the tests of matching."""

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


def blob(seed: int, n: int = 60, phase: float = 0.0) -> Points:
    """A smooth closed curve (n, 2) px about (125, 125), counterclockwise seen with y up."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, n, endpoint=False) + phase
    waves = [(rng.normal(0, 20 / k), rng.uniform(0, 6), k) for k in range(2, 7)]
    r = 60 + sum(a * np.cos(k * t + p) for a, p, k in waves)
    return np.stack([125 + r * np.cos(t), 125 + r * np.sin(t)], -1)


def tangents(points: Points) -> NDArray[np.float64]:
    """Direction (n,) in radians along a closed curve (n, 2)."""
    step = np.roll(points, -1, 0) - np.roll(points, 1, 0)
    return np.arctan2(step[:, 1], step[:, 0])


def rotated(points: Points, angle: float) -> Points:
    """Points turned by an angle in radians, x towards y, about (125, 125)."""
    c, s = np.cos(angle), np.sin(angle)
    return (points - 125) @ np.array([[c, s], [-s, c]]) + 125
