"""Choosing N of an edge's points."""

import numpy as np
from numpy.typing import NDArray


def sample(
    points: NDArray[np.float32], n: int, method: str = "farthest", weights: NDArray[np.float32] | None = None
) -> NDArray[np.int64]:
    """Indices (min(n, N),) of points (N, 2) spread evenly: each next one is the farthest from those taken."""
    if len(points) <= n:
        return np.arange(len(points))
    taken = np.zeros(n, np.int64)
    gap = np.full(len(points), np.inf)
    nxt = int(np.argmax(weights)) if weights is not None else 0
    for i in range(n):
        taken[i] = nxt
        gap = np.minimum(gap, ((points - points[nxt]) ** 2).sum(1))
        nxt = int(gap.argmax())
    return taken
