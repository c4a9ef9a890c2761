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
        starts: how many rotations of the second outline's numbering are tried, best even alignments first, of all
            ways together.
        within: how far an alignment may lead or lag behind the even one (Sakoe and Chiba's band), as a share of the
            outline's length; 1 for any.
    """

    skip: float = 0.3
    starts: int = 3
    within: float = 0.16

    def __post_init__(self) -> None:
        if not self.skip > 0 or self.starts < 1 or not 0 < self.within <= 1:
            raise InputError(
                f"Ordered needs skip > 0, starts >= 1 and 0 < within <= 1, got {self.skip}, {self.starts} and "
                f"{self.within}."
            )


def align_outlines(cost: Tensor, settings: Ordered) -> Tensor:
    """Cost of the best alignment of two closed outlines that keeps the order of points, a point.

    Args:
        cost: (W, B, N, N) float32, costs of a point of the first (rows) against one of the second outline (columns),
            for B pairs of outlines and W ways to see one of them, such as mirrored; all run the same way round.
        settings: see `Ordered`.

    Returns:
        (B,) sum of matched costs and skips, divided by N, of the best of the ways.
    """
    if cost.ndim != 4 or cost.shape[2] != cost.shape[3] or not cost.shape[0] * cost.shape[2]:
        raise ShapeError(f"Expected costs (W, B, N, N) with W, N > 0, got {tuple(cost.shape)}.")
    ways, b, n = cost.shape[:3]
    reach = max(1, round(settings.within * n))
    around = torch.cat([cost[..., n - reach :], cost, cost, cost[..., :reach]], 3)
    width = around.shape[3]
    whole = n * width
    bands = around.as_strided((b, ways, n, n, 2 * reach + 1), (whole, b * whole, 1, width + 1, 1))  # of each rotation
    way, shift = _best_starts(bands[..., reach].sum(3), settings.starts)
    tried = bands[torch.arange(b), way, shift].flatten(0, 1)  # all starts at once
    return _align(tried, settings.skip).view(len(shift), b).amin(0) / n


def _best_starts(even: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The ways and rotations (count, B) of lowest cost (B, W, N) of an even alignment, no two of them neighbors."""
    n = even.shape[2]
    even, spread = even.flatten(1), torch.arange(-(n // 32), n // 32 + 1)
    starts = torch.empty(count, len(even), dtype=torch.long)
    for k in range(count):
        starts[k] = even.argmin(1)
        neighbors = (starts[k] % n)[:, None] + spread
        even.scatter_(1, (starts[k] // n * n)[:, None] + neighbors % n, torch.inf)
    return starts // n, starts % n


def _align(cost: Tensor, skip: float) -> Tensor:
    """Cost (B,) of the best monotone alignment from corner to corner of a band (B, N, 2 R + 1), whose row i holds the
    costs of columns i - R to i + R.

    Cell (i, j) holds the least cost of the first i and j points. The cells of one i + j lie on every second of the
    band's lines j - i = R, R - 1, ... -R and depend only on the two sums before: they are computed together, in place.
    Before the table cells stay infinite, as all that leads to them is; what lies behind it leads nowhere back.
    """
    b, n, width = cost.shape
    reach = width // 2
    before = reach // 2 + 1
    table = torch.zeros(n + 2 * before, width, b)
    table[before : before + n] = cost.permute(1, 2, 0)
    least, other = torch.full((reach + 1, b), torch.inf), torch.full((reach + 2, b), torch.inf)
    lines = (least, other[1:-1])  # j - i = R, R - 2, ... and R - 1, R - 3, ...; beside the second lies infinity
    beside = ((other[:-1], other[1:]), (least[:-1], least[1:]))
    ends = lines[reach % 2][reach // 2]  # j = i
    ends.fill_(0.0)
    skipped = torch.empty_like(least)
    for d in range(1, 2 * n + 1):
        k = (reach - d) % 2
        line, last = lines[k], skipped[: len(lines[k])]
        row = ((d - reach + k) // 2 - 1 + before) * width + 2 * reach - k
        torch.minimum(*beside[k], out=last).add_(skip)
        line.add_(table.as_strided(line.shape, ((width - 2) * b, 1), row * b))
        torch.minimum(line, last, out=line)
    return ends.clone()
