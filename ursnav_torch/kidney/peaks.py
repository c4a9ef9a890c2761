"""Peaks of a field on the voxels of a lumen, and how prominent each is."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


def prominent_peaks(height: Array, graph: csr_array, least: float) -> tuple[IntArray, Array]:
    """Voxels (P,) of the peaks of ``height`` (V,) that stand out by more than ``least``, most prominent first.

    Returns them and their prominences (P,): how far one must go down from a peak to reach a higher one (0-dimensional
    persistence); infinite for the highest of a component. Every voxel climbs to its peak, then peaks are joined over
    the highest passes between them, and the lower of two ends where they join.
    """
    edges = graph.tocoo()
    peak_of = _climb(height, edges.row, edges.col)
    passes = np.minimum(height[edges.row], height[edges.col])
    border = np.flatnonzero(peak_of[edges.row] < peak_of[edges.col])
    border = border[np.argsort(-passes[border], kind="stable")]
    higher = {int(p): int(p) for p in np.unique(peak_of)}
    prominence = dict.fromkeys(higher, np.inf)
    for e in border:
        a, b = (_summit(higher, int(peak_of[v])) for v in (edges.row[e], edges.col[e]))
        if a != b:
            low, high = (a, b) if height[a] < height[b] else (b, a)
            higher[low], prominence[low] = high, float(height[low] - passes[e])
    peaks, sizes = np.array(list(prominence)), np.array(list(prominence.values()))
    order = np.lexsort((-height[peaks], -sizes))
    order = order[sizes[order] > least]
    return peaks[order], sizes[order]


def _climb(height: Array, i: IntArray, j: IntArray) -> IntArray:
    """(V,) the peak that every voxel reaches by steps to its highest neighbor; edges run from ``i`` to ``j`` (E,)."""
    order = np.lexsort((height[j], i))
    last = order[np.append(np.flatnonzero(np.diff(i[order])), len(order) - 1)]
    up = np.arange(len(height))
    rises = height[j[last]] > height[i[last]]
    up[i[last][rises]] = j[last][rises]
    while np.any(up[up] != up):
        up = up[up]
    return up


def _summit(higher: dict[int, int], peak: int) -> int:
    while higher[peak] != peak:
        peak = higher[peak]
    return peak
