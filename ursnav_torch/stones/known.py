"""Stones known from a scan beside those that pictures showed: found, not yet found, new."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ursnav_torch.geometry import Array
from ursnav_torch.stones.map import THERE, FoundStone

#: A stone moves between the scan and the operation, mm at scale 1: about its own size, and this besides.
_MOVED_MM = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class KnownStone:
    """A stone of a scan: its name, its middle (3,) in the kidney frame and its longest diameter, mm."""

    name: str
    center_mm: Array
    size_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class StoneList:
    """All stones of an operation.

    Attributes:
        seen: those that pictures showed.
        known: of each of them the name of the known stone that it is, blank for a new one.
        not_found: known ones that no picture showed.
        compared: whether stones were known at all.
        fragments: what was seen besides and is there, too small for a stone and none of the known ones.
    """

    seen: tuple[FoundStone, ...]
    known: tuple[str, ...]
    not_found: tuple[KnownStone, ...]
    compared: bool
    fragments: tuple[FoundStone, ...] = ()


#: Before any picture.
NO_STONES = StoneList((), (), (), False)


def compare_stones(seen: Sequence[FoundStone], known: Sequence[KnownStone], scale: float = 1.0) -> StoneList:
    """Match stones that pictures showed to those of a scan, each to one at most, by place and size.

    Args:
        seen, known: in one kidney frame; a fragment that is a known stone is one.
        scale: the kidney's.
    """
    names = [""] * len(seen)
    cost = np.full((len(seen), len(known)), np.inf)
    for i, s in enumerate(seen):
        for j, k in enumerate(known):
            reach = _MOVED_MM * scale + max(s.size_mm, k.size_mm) / 2 + 2 * s.position_sd_mm
            gap = float(np.linalg.norm(s.center_mm - k.center_mm)) / reach
            if gap < 1:
                cost[i, j] = gap + 0.5 * abs(np.log(s.size_mm / k.size_mm))
    rows, columns = linear_sum_assignment(np.minimum(cost, 1e3))
    found = set[int]()
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        if np.isfinite(cost[i, j]):
            names[i] = known[j].name
            found.add(j)
    missing = tuple(k for j, k in enumerate(known) if j not in found)
    listed = [i for i, s in enumerate(seen) if names[i] or not s.is_fragment]
    fragments = tuple(s for i, s in enumerate(seen) if i not in listed and s.state == THERE)
    return StoneList(tuple(seen[i] for i in listed), tuple(names[i] for i in listed), missing, bool(known), fragments)
