"""All pairs of points of a set, each computed once: the point k places further on, for k up to half of the points.

What one point sees of another is what that sees of it, half a turn round, so that distances and angles are needed for
half of the pairs alone; and a set laid out twice in a row holds all of them without any gathering.
"""

import math
import threading
from collections.abc import Iterator

import torch
from torch import Tensor

#: Pairs handled at once, so that what is computed of them stays in the second-level cache.
PAIRS_AT_A_TIME = 40_000
_kept = threading.local()
#: Where padding stands, in units of a set's scale: beyond any reach, no two of it at one place.
_FAR = 1e6


def padded_far(points: Tensor, mask: Tensor) -> Tensor:
    """Points (B, P, 2) with those that the mask (B, P) rules out moved out of everybody's reach."""
    if bool(mask.all()):
        return points
    away = torch.zeros(points.shape[1], 2)
    away[:, 0] = _FAR * torch.arange(1.0, points.shape[1] + 1)
    return torch.where(mask[..., None], points, away)


def differences(points: Tensor, out: Tensor | None = None) -> Tensor:
    """From every point (B, P, 2) to the one k places further on, the last followed by the first.

    Args:
        points: (B, P, 2) float32.
        out: (2, B, P // 2, P) float32 to be written to.

    Returns:
        (2, B, P // 2, P) x and y; row k - 1 for k places. For even P the last row holds every pair twice.
    """
    b, p = points.shape[:2]
    twice = torch.cat([points, points], 1).permute(2, 0, 1).contiguous()
    ahead = twice.as_strided((2, b, p // 2, p), (2 * b * p, 2 * p, 1, 1), 1)
    return torch.sub(ahead, twice[:, :, None, :p], out=out)


def ahead(row: Tensor) -> Tensor:
    """A number a point (B, P) as the point k places further on has it, (B, P // 2, P): beside `differences`."""
    b, p = row.shape
    return torch.cat([row, row], 1).as_strided((b, p // 2, p), (2 * p, 1, 1), 1)


def repeated(count: int) -> bool:
    """Whether the last row of `differences` between P points holds every pair twice, from either end."""
    return count > 0 and count % 2 == 0


def sets_at_a_time(count: int) -> int:
    """How many sets of ``count`` points have pairs that fit the cache."""
    return max(1, PAIRS_AT_A_TIME // max(1, count * (count // 2)))


def slices(sets: slice, count: int) -> Iterator[slice]:
    """Slices of sets of ``count`` points, so many at a time."""
    step = sets_at_a_time(count)
    for start in range(sets.start, sets.stop, step):
        yield slice(start, min(start + step, sets.stop))


class PairBins:
    """Counts the neighbors of every point by ring and sector; it holds the memory that it works in.

    Args:
        sets: how many there will be in all.
        count: points a set, P.
        radii: (R,) outer edges of the rings, even in the logarithm.
        sectors: of a ring, A.
    """

    def __init__(self, sets: int, count: int, radii: Tensor, sectors: int) -> None:
        self._count, self._rings, self._sectors = count, len(radii), sectors
        first, last = math.log2(float(radii[0])), math.log2(float(radii[-1]))
        self._slope = (len(radii) - 1) / (last - first)  # rings an octave
        self._first = 1 - self._slope * first
        step, half, wide = min(sets, sets_at_a_time(count)), count // 2, (len(radii) + 1) * sectors
        here = torch.arange(count)
        there = (here + torch.arange(1, half + 1)[:, None]) % count
        row = torch.stack([here.expand(half, count), there]).view(2, 1, half, count)
        self._row = ((row + torch.arange(step)[:, None, None] * count) * wide).float()  # of the pair's two points
        self._index = torch.empty(self._row.shape, dtype=torch.long)
        self._work = torch.empty(2, 2, step, half, count)
        self._squared = torch.empty(step, half, count)
        self._ones = torch.ones(2, step, half, count)
        if repeated(count):
            self._ones[1, :, -1] = 0.0
        self._sums = torch.empty(step, count, wide)

    def count(self, points: Tensor, phase: Tensor | float, weights: Tensor | None = None) -> Tensor:
        """Neighbors (B, P, R, A) of every point.

        Args:
            points: (B, P, 2) in units of the radii, B no more than `sets_at_a_time`.
            phase: (B, P) sectors added to a neighbor's direction, as the point sees it, before it is rounded down; or
                one number for all.
            weights: (B, P) how much a point counts as a neighbor; 1 where left out.

        Returns:
            A view of memory that the next call overwrites. Points at one place do not see each other.
        """
        b, bins = len(points), self._index[:, : len(points)]
        step = differences(points, self._work[0, :, :b])
        squared = torch.mul(step[0], step[0], out=self._squared[:b]).addcmul_(step[1], step[1])
        if squared.numel() and float(squared.amin()) < 1e-10:
            squared.masked_fill_(squared < 1e-10, math.inf)
        ring = squared.log2_().mul_(self._slope / 2).add_(self._first).clamp_(0, self._rings).floor_()
        turns = torch.atan2(step[1], step[0], out=step[0]).mul_(self._sectors / math.tau)
        sector = self._wrapped(turns, phase, self._work[:, :, :b])
        bins.copy_(sector.add_(ring.mul_(self._sectors)).add_(self._row[:, :b]))
        sums = self._sums[:b].zero_()
        sums.view(-1).scatter_add_(0, bins.reshape(-1), self._counts(b, weights).reshape(-1))
        return sums.view(b, self._count, self._rings + 1, self._sectors)[:, :, : self._rings]

    def _wrapped(self, turns: Tensor, phase: Tensor | float, work: Tensor) -> Tensor:
        """Sector (2, B, H, P) in 0..A-1 of each direction, given in sectors, and of its opposite; see `count`."""
        out, half = work[1], self._sectors / 2
        here, there = (phase[:, None], ahead(phase)) if isinstance(phase, Tensor) else (phase, phase)
        torch.add(turns, here, out=out[0])
        torch.add(turns, there + half, out=out[1])
        whole = torch.add(out.floor_(), 0.5, out=work[0]).mul_(1 / self._sectors).floor_()
        return out.sub_(whole, alpha=self._sectors)

    def _counts(self, sets: int, weights: Tensor | None) -> Tensor:
        """What each pair (2, B, H, P) adds: its far point's weight to its near point, and the other way round."""
        if weights is None:
            return self._ones[:, :sets]
        both = torch.stack([ahead(weights), weights[:, None].expand(-1, self._count // 2, -1)])
        return both * self._ones[:, :sets]


def pair_bins(sets: int, count: int, radii: Tensor, sectors: int) -> PairBins:
    """`PairBins` for this thread alone: the last one's memory is used again, as fresh pages are slow.

    Sets so large that no two fit the cache get memory of their own, which goes when they are done.

    Args:
        sets, count, radii, sectors: as `PairBins` takes them; radii (R,).
    """
    if count * (count // 2) > PAIRS_AT_A_TIME // 2:
        return PairBins(sets, count, radii, sectors)
    wanted = (count, tuple(radii.tolist()), sectors)
    if getattr(_kept, "wanted", None) != wanted:
        with torch.inference_mode(False):  # it outlives the mode it is made in
            _kept.bins, _kept.wanted = PairBins(sets_at_a_time(count), count, radii, sectors), wanted
    bins: PairBins = _kept.bins
    return bins
