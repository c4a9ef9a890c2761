"""The order of visits: the shortest open tour through the calyces, which on a tree is found exactly.

Every edge of the tree that the tour uses is passed twice, but for the way to where it ends; so the tour that ends at
the farthest calyx is the shortest, and it visits the branches depth first with the one that holds this calyx last.
"""

import itertools
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.route import along, node_at, to_root
from ursnav_torch.kidney import Kidney

Array = NDArray[np.float64]


class Tour:
    """Ways between calyces along one kidney's centerline.

    Args:
        kidney: whose.
        short_mm: a visit ends this far before a calyx's tip, mm of this kidney.
        ends_mm: for every calyx, how far along its way a visit goes at most; None for no such end.
    """

    def __init__(self, kidney: Kidney, short_mm: float, ends_mm: Sequence[float] | None = None) -> None:
        self.kidney, self.tree = kidney, kidney.centerline
        farthest = ends_mm if ends_mm is not None else [np.inf] * len(kidney.calyces)
        self._ends = [self._end(calyx, short_mm, float(most)) for calyx, most in enumerate(farthest)]

    def order(self, position_mm: Array, calyces: Collection[int], late: Collection[int] = ()) -> list[int]:
        """The shortest order to visit some calyces in, from a place (3,) in the lumen, kidney frame.

        Args:
            position_mm: where the scope is.
            calyces: to be visited.
            late: those that are to come after all others: hard to reach, or tried before.
        """
        start = node_at(self.kidney, position_mm)
        first, last = [c for c in calyces if c not in late], [c for c in calyces if c in late]
        found = self._order(start, first)
        return found + self._order(self._ends[found[-1]] if found else start, last)

    def length_mm(self, position_mm: Array, calyces: Collection[int]) -> float:
        """Length of the way through calyces in the order given, from a place (3,) in the lumen."""
        nodes = [node_at(self.kidney, position_mm), *(self._ends[c] for c in calyces)]
        return sum(self._between(a, b) for a, b in itertools.pairwise(nodes))

    def _order(self, start: int, calyces: list[int]) -> list[int]:
        """The branches by nearness of their farthest calyx, so that the farthest of all comes last."""
        away = {c: self._between(start, self._ends[c]) for c in calyces}
        ways = {c: self._way(start, self._ends[c]) for c in calyces}
        return _depth_first(sorted(calyces), ways, away, 1)

    def _end(self, calyx: int, short_mm: float, most_mm: float) -> int:
        path = self.tree.path_to(calyx)
        way = along(self.tree.points_mm[path])
        return int(path[np.flatnonzero(way <= max(min(way[-1] - short_mm, most_mm), 0.0))[-1]])

    def _way(self, a: int, b: int) -> list[int]:
        """Nodes from one to another."""
        up, down = to_root(self.tree.parent, a), to_root(self.tree.parent, b)
        common = set(up) & set(down)
        turn = next(n for n in up if n in common)
        return [*(n for n in up if n not in common), turn, *(n for n in reversed(down) if n not in common)]

    def _between(self, a: int, b: int) -> float:
        way = self._way(a, b)
        return float(np.linalg.norm(np.diff(self.tree.points_mm[way], axis=0), axis=1).sum())


def _depth_first(calyces: list[int], ways: dict[int, list[int]], away: dict[int, float], depth: int) -> list[int]:
    """Calyces that share their way up to ``depth`` nodes, those of one branch together, the farthest branch last."""
    if len(calyces) < 2:
        return calyces
    branches: dict[int, list[int]] = {}
    for calyx in calyces:
        way = ways[calyx]
        branches.setdefault(way[depth] if depth < len(way) else -1, []).append(calyx)
    if -1 in branches:
        ended = branches.pop(-1)
        return ended + _depth_first([c for c in calyces if c not in ended], ways, away, depth)
    ordered = sorted(branches.values(), key=lambda branch: max(away[c] for c in branch))
    return [c for branch in ordered for c in _depth_first(branch, ways, away, depth + 1)]
