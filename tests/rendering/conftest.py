"""A small lumen to draw: a bumpy egg, star-shaped around the origin, with folds that hide wall behind them."""

import numpy as np
import pytest
import trimesh

from ursnav_torch.geometry import look_along


@pytest.fixture(scope="session")
def lumen() -> trimesh.Trimesh:
    egg = trimesh.creation.icosphere(subdivisions=5)
    x, y, z = egg.vertices.T
    bumps = 1 + 0.3 * np.sin(4 * np.arctan2(y, x)) * (1 - z * z) + 0.2 * np.cos(7 * z)
    return trimesh.Trimesh(egg.vertices * bumps[:, None] * [6, 5, 10], egg.faces, process=False)


@pytest.fixture(scope="session")
def poses() -> np.ndarray:
    """(4, 4, 4) inside the lumen, looking about."""
    positions = [[0, 0, -4], [0.5, 0.4, 0], [-1, 0.5, 3], [1, 0, -2]]
    directions = [[0, 0.1, 1], [1, 0, 0.2], [0, 0.3, -1], [0.2, -1, 0.5]]
    return look_along(positions, directions, 0.3)
