"""Which edge points to keep: evenly along the edges, far from each other, or where edges bend.

The thesis leaves open which points should stay (section 6.2.3); `benchmarks.matching` measures it.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from ursnav_torch.errors import InputError, ShapeError

METHODS = ("uniform", "farthest", "curvature")

#: Neighbors considered when points are joined to chains.
_NEIGHBORS = 6
#: Points farther apart than this many times the usual spacing are not joined.
_GAP = 3.0
#: Share of the mass that "curvature" spreads by bending; the rest is even, so that no edge is lost.
_BENDING = 0.5
#: Mean bending below which edges count as straight, and length alone decides.
_STRAIGHT = 1e-3


def sample(points: ArrayLike, n: int, method: str = "uniform", weights: ArrayLike | None = None) -> NDArray[np.int64]:
    """Choose `n` of the points (N, 2), unordered edge pixels of any number of curves.

    "uniform" spaces them evenly along the curves, "farthest" adds again and again the point that is farthest
    from those chosen, "curvature" spaces them half by length and half by how much the curve bends.

    Args:
        points: (N, 2) px.
        n: how many to keep, at least 1.
        method: see above.
        weights: (N,) >= 0; a stretch of weight 2 gets twice as many points ("farthest": points count as if
            twice as far away). Weight 0 is never chosen while others are left.

    Returns:
        Indices, ascending, without repetition: `n`, or all N if there are no more.

    Raises:
        ShapeError: not (N, 2), or weights not (N,).
        InputError: n below 1, an unknown method, or negative weights.
    """
    p, w = _checked(points, n, method, weights)
    if len(p) <= n:
        return np.arange(len(p))
    if method == "farthest":
        return np.sort(_farthest(p, n, w))
    order, length = chain(p)
    mass = length * w[order]
    if method == "curvature":
        bend = bending(p)[order] * mass
        if bend.sum() > _STRAIGHT * mass.sum():
            mass = (1 - _BENDING) * mass / mass.sum() + _BENDING * bend / bend.sum()
    return np.sort(order[_evenly(mass, n)])


def check_method(method: str) -> None:
    """Refuse a way of sampling that does not exist, so that settings can do so before any work.

    Raises:
        InputError: naming those that do.
    """
    if method not in METHODS:
        raise InputError(f"sampling is {method!r}; accepted are {', '.join(map(repr, METHODS))}.")


def _checked(
    points: ArrayLike, n: int, method: str, weights: ArrayLike | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p = np.asarray(points, float)
    p = p.reshape(0, 2) if p.size == 0 else p
    w = np.ones(len(p)) if weights is None else np.asarray(weights, float)
    if p.ndim != 2 or p.shape[1] != 2 or w.shape != p.shape[:1]:
        raise ShapeError(f"Expected points (N, 2) and weights (N,), got {p.shape} and {w.shape}.")
    if n < 1:
        raise InputError(f"n must be at least 1, got {n}.")
    check_method(method)
    if w.size and not w.min() >= 0:
        raise InputError(f"Weights must be >= 0, found {w.min()}.")
    return p, w + 1e-9 * max(w.max(initial=0), 1)


def chain(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Unordered points (N, 2), N > 1, in an order that runs along the curves.

    Returns:
        The order (N,), and the length of curve that each point of it stands for (N,) in px.
    """
    k = min(_NEIGHBORS, len(points) - 1)
    distance, neighbor = cKDTree(points).query(points, k + 1)
    distance, neighbor = np.maximum(distance[:, 1:], 1e-9), neighbor[:, 1:]
    limit = _GAP * np.median(distance[:, 0])
    rows = np.repeat(np.arange(len(points)), k)
    near = distance.ravel() <= limit
    graph = csr_matrix((distance.ravel()[near], (rows[near], neighbor.ravel()[near])), shape=(len(points),) * 2)
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    tree = tree + tree.T
    count, label = connected_components(tree, directed=False)
    degree = np.diff(tree.indptr)
    start = np.lexsort((degree, label))[np.searchsorted(np.sort(label), np.arange(count))]
    order = np.concatenate([depth_first_order(tree, s, directed=False)[0] for s in start]).astype(np.int64)
    half = np.asarray(tree.sum(1)).ravel()[order] / 2
    return order, np.maximum(half, 1e-9)


def bending(points: NDArray[np.float64], neighbors: int = 9) -> NDArray[np.float64]:
    """How far the neighborhood of each point (N,) is from a straight line: 0 on a line, at most 1."""
    k = min(neighbors, len(points))
    _, index = cKDTree(points).query(points, k)
    local = points[index.reshape(len(points), k)]
    centered = local - local.mean(1, keepdims=True)
    xx, yy = (centered[..., 0] ** 2).sum(1), (centered[..., 1] ** 2).sum(1)
    xy = (centered[..., 0] * centered[..., 1]).sum(1)
    spread = np.hypot(xx - yy, 2 * xy)
    return np.clip(1 - spread / np.maximum(xx + yy, 1e-12), 0, 1)


def _evenly(mass: NDArray[np.float64], n: int) -> NDArray[np.int64]:
    """`n` different places (n,) in a row of masses (N,), evenly in cumulated mass."""
    cumulated = np.cumsum(mass)
    targets = (np.arange(n) + 0.5) * cumulated[-1] / n
    places = np.minimum(np.searchsorted(cumulated, targets), len(mass) - 1)
    # Push repeated places apart, first upwards, then back down from the end.
    steps = np.arange(n)
    places = np.maximum.accumulate(places - steps) + steps
    return np.minimum(places, len(mass) - n + steps).astype(np.int64)


def _farthest(points: NDArray[np.float64], n: int, weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Farthest-point sampling (n,), from the point farthest from the middle on."""
    chosen = np.empty(n, np.int64)
    places, squared_weights = np.ascontiguousarray(points.T), weights**2
    left, off, worth = np.full(len(points), np.inf), np.empty_like(places), np.empty(len(points))

    def weigh(place: NDArray[np.float64]) -> None:
        """How far each point is from a place (2, 1), squared, times its weight: all in arrays that are there."""
        np.subtract(places, place, out=off)
        np.multiply(off, off, out=off)
        np.add(off[0], off[1], out=worth)
        np.multiply(worth, squared_weights, out=worth)

    weigh(points.mean(0)[:, None])
    across = worth
    for i in range(n):
        chosen[i] = at = across.argmax()
        weigh(places[:, at : at + 1])
        np.minimum(left, worth, out=left)
        left[at] = -1.0
        across = left
    return chosen
