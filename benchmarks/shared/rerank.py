"""Distances made better by the neighborhood that shapes share, without labels.

Yang, Koknar-Tezel, Latecki: Locally constrained diffusion process on locally densified distance spaces, CVPR 2009.
It uses the other shapes of the gallery, so figures with it stand beside those without, never in their place.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def diffuse(distances: Floats, neighbors: int = 8, width: float = 0.5, steps: int = 5) -> Floats:
    """Similarities (N, N), higher is nearer, of symmetric distances (N, N) after diffusion over neighbors.

    Args:
        distances: (N, N), symmetric.
        neighbors: how many neighbors similarity flows through.
        width: of the affinity's bell, in units of the mean of the distance and both shapes' mean distance to
            their neighbors.
        steps: of diffusion.
    """
    distances = distances.copy()
    np.fill_diagonal(distances, 0.0)
    k = min(neighbors, len(distances) - 1)
    own = np.sort(distances, 1)[:, 1 : k + 1].mean(1)
    scale = width * (own[:, None] + own[None] + distances) / 3
    affinity = np.exp(-((distances / np.maximum(scale, 1e-12)) ** 2))
    local = np.zeros_like(affinity)
    nearest = np.argpartition(distances, k, 1)[:, : k + 1]
    np.put_along_axis(local, nearest, np.take_along_axis(affinity, nearest, 1), 1)
    local /= local.sum(1, keepdims=True)
    spread = affinity / affinity.sum(1, keepdims=True)
    for _ in range(steps):
        spread = local @ spread @ local.T
    return spread + spread.T
