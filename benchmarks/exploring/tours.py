"""How short an exploration's path could be."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.neck import find_neck
from ursnav_torch.autonomy.steering import Way
from ursnav_torch.autonomy.tour import Tour
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.kidney import Kidney
from ursnav_torch.scaling import scaled

Array = NDArray[np.float64]


def shortest_tours_mm(
    kidney: Kidney, standoff_mm: float, stone: Array, blocked: int, looked_into: Collection[int]
) -> tuple[float, float]:
    """Lengths of the shortest tours from the root of the centerline.

    Args:
        kidney: whose.
        standoff_mm: a visit ends this far before a calyx's tip.
        stone, blocked: a stone (x, y, z, radius) that the map does not know, and the calyx (index) that it closes.
        looked_into: calyces in reach, and those behind a neck that were looked into from before it.

    Returns:
        Through the calyces looked into; and with the way to the stone, which is to be found.
    """
    start, count = kidney.centerline.points_mm[0], range(len(kidney.calyces))
    ways = [Way(kidney, calyx) for calyx in count]
    necks = [find_neck(way, scaled(ScopeLimits(), kidney.scale), kidney.scale) for way in ways]
    ends = [np.inf if neck is None else neck.end_mm for neck in necks]
    ends[blocked] = min(ends[blocked], ways[blocked].place_mm(stone[:3]) - float(stone[3]))
    tour = Tour(kidney, standoff_mm, ends)
    found = [tour.length_mm(start, tour.order(start, which)) for which in (looked_into, {*looked_into, blocked})]
    return found[0], found[1]
