"""Matching of closed outlines whose points have an order, by dynamic programming.

The order of the points is kept, as in Ling and Jacobs, Shape classification using the inner-distance, PAMI 2007,
section 4, with the shape context in place of theirs.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ursnav_torch.errors import InputError, ShapeError


@dataclass(frozen=True, slots=True)
class Ordered:
    """How two outlines are aligned.

    Attributes:
        skip: cost of leaving out a point of either outline; half the pair cost above which two are left out.
        starts: how many rotations of the second outline's numbering are tried, best even alignments first.
    """

    skip: float = 0.3
    starts: int = 3

    def __post_init__(self) -> None:
        if not self.skip > 0 or self.starts < 1:
            raise InputError(f"Ordered needs skip > 0 and starts >= 1, got {self.skip} and {self.starts}.")


def align_outlines(cost: Tensor, settings: Ordered) -> Tensor:
    """Cost of the best alignment of two closed outlines that keeps the order of points, a point.

    Args:
        cost: (N, M, B) costs of point n of the first against point m of the second outline, B pairs of outlines;
            both run the same way round.
        settings: see `Ordered`.

    Returns:
        (B,) sum of matched costs and skips, divided by N.
    """
    if cost.ndim != 3 or 0 in cost.shape[:2]:
        raise ShapeError(f"Expected costs (N, M, B) with N, M > 0, got {tuple(cost.shape)}.")
    n, m, b = cost.shape
    shifts = _best_shifts(cost, settings.starts)
    best = torch.full((b,), torch.inf)
    for shift in shifts:
        columns = (torch.arange(m)[:, None] + shift) % m
        turned = cost.gather(1, columns.expand(n, m, b))
        torch.minimum(best, _align(turned, settings.skip), out=best)
    return best / n


def _best_shifts(cost: Tensor, count: int) -> Tensor:
    """The rotations (count, B) of lowest mean cost along the diagonal, no two of them neighbors."""
    n, m, b = cost.shape
    twice = torch.cat([cost, cost], 1)
    diagonal = torch.zeros(m, b)
    for i in range(n):
        start = (i * m) // n
        diagonal += twice[i, start : start + m]
    shifts = torch.empty(count, b, dtype=torch.long)
    spread = torch.arange(-(m // 32), m // 32 + 1)[:, None]
    for k in range(count):
        shifts[k] = diagonal.argmin(0)
        diagonal.scatter_(0, (shifts[k] + spread) % m, torch.inf)
    return shifts


def _align(cost: Tensor, skip: float) -> Tensor:
    """Cost (B,) of the best monotone alignment from corner to corner of (N, M, B), contiguous.

    Cell (i, j) holds the least cost of the first i and j points; cells of equal i + j depend only on the two
    diagonals before and are computed together.
    """
    n, m, b = cost.shape
    older, old, new = (torch.empty(n + 1, b) for _ in range(3))
    old[0] = 0.0
    for d in range(1, n + m + 1):
        low, high = max(0, d - m), min(n, d)
        if low == 0:
            new[0] = d * skip
        if high == d:
            new[d] = d * skip
        first, last = max(low, 1), min(high, d - 1)
        if first <= last:
            pairs = cost.as_strided((last - first + 1, b), ((m - 1) * b, 1), ((first - 1) * m + d - first - 1) * b)
            target = new[first : last + 1]
            torch.minimum(old[first : last + 1], old[first - 1 : last], out=target)
            target.add_(skip)
            torch.minimum(target, older[first - 1 : last].add_(pairs), out=target)
        older, old, new = old, new, older
    return old[n].clone()
