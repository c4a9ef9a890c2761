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
    a, b, passes = _passes(peak_of[edges.row], peak_of[edges.col], np.minimum(height[edges.row], height[edges.col]))
    higher = {int(p): int(p) for p in np.unique(peak_of)}
    prominence = dict.fromkeys(higher, np.inf)
    for one, other, saddle in zip(a.tolist(), b.tolist(), passes.tolist(), strict=True):
        low, high = sorted((_summit(higher, one), _summit(higher, other)), key=lambda p: height[p])
        if low != high:
            higher[low], prominence[low] = high, float(height[low] - saddle)
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


def _passes(a: IntArray, b: IntArray, height: Array) -> tuple[IntArray, IntArray, Array]:
    """The highest pass between any two peaks: peaks ``a`` < ``b`` and its height (P,), from the highest down."""
    between = a < b
    a, b, height = a[between], b[between], height[between]
    order = np.lexsort((-height, b, a))
    a, b, height = a[order], b[order], height[order]
    first = np.append(True, (np.diff(a) != 0) | (np.diff(b) != 0))[: len(a)]
    down = np.argsort(-height[first], kind="stable")
    return a[first][down], b[first][down], height[first][down]


def _summit(higher: dict[int, int], peak: int) -> int:
    while higher[peak] != peak:
        peak = higher[peak]
    return peak
