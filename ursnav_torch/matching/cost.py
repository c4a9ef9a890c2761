"""The cost of taking one point for another: shape context, position and edge direction, a weight each."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.errors import InputError

#: Cost at a place where the view has no point: above every true cost, and no minimum ever picks it.
ABSENT = 1e3


@dataclass(frozen=True, slots=True)
class PairCost:
    """Weighted mean of up to three terms, each between 0 and 1.

    Attributes:
        compare: "hellinger", 1 - sum sqrt(a b), a matrix product; or "chi2", 1/2 sum (a - b)^2 / (a + b).
        shape_weight: weight of the shape contexts' difference.
        position_weight: weight of the distance in the picture, clamped at `position_clamp_px` and divided by it.
        position_clamp_px: distance from which on farther is no worse.
        direction_weight: weight of sin^2 of the angle between the edges (modulo pi: an edge has no head and no tail).
    """

    compare: Literal["hellinger", "chi2"] = "hellinger"
    shape_weight: float = 1.0
    position_weight: float = 0.0
    position_clamp_px: float = 60.0
    direction_weight: float = 0.0

    def __post_init__(self) -> None:
        if self.compare not in ("hellinger", "chi2"):
            raise InputError(f"compare is {self.compare!r}; accepted are 'hellinger' and 'chi2'.")
        weights = (self.shape_weight, self.position_weight, self.direction_weight)
        if min(weights) < 0 or sum(weights) <= 0:
            raise InputError(f"Weights of shape, position and direction must be >= 0 and not all 0, got {weights}.")
        if not self.position_clamp_px > 0:
            raise InputError(f"position_clamp_px must be > 0, got {self.position_clamp_px}.")

    def shares(self) -> tuple[float, float, float]:
        """Weights of shape, position and direction, summing to 1."""
        weights = (self.shape_weight, self.position_weight, self.direction_weight)
        shape, position, direction = (w / sum(weights) for w in weights)
        return shape, position, direction


def view_features(histograms: Tensor, direction: Tensor | None, mask: Tensor, cost: PairCost) -> Tensor:
    """Columns (..., F, P) of views whose products with `query_features` are all of the cost that is a product.

    The last row holds the constant part, or `ABSENT` where the mask (..., P) is false.

    Args:
        histograms: (..., P, D) shape contexts, zero where there is no point.
        direction: (..., P) radians, or None.
        mask: (..., P) bool.
        cost: what is weighed.

    Raises:
        InputError: the cost weighs edge direction and none is given.
    """
    shape, _, along = cost.shares()
    bins = histograms.shape[-1] if cost.compare == "hellinger" else 0
    out = torch.empty(*mask.shape[:-1], bins + (2 if along > 0 else 0) + 1, mask.shape[-1])
    if bins:
        _to_roots(out[..., :bins, :].copy_(histograms.transpose(-1, -2)), shape)
    if along > 0:
        out[..., bins : bins + 2, :] = _doubled(direction, along).transpose(-1, -2) * mask[..., None, :]
    out[..., -1, :] = torch.where(mask, along / 2 + (shape if bins else 0.0), ABSENT)
    return out


def query_features(histograms: Tensor, direction: Tensor | None, cost: PairCost) -> Tensor:
    """Rows (..., Pq, F) of a query for `view_features`."""
    shape, _, along = cost.shares()
    columns = [_to_roots(histograms.clone(), shape).neg_()] if cost.compare == "hellinger" else []
    if along > 0:
        columns.append(-_doubled(direction, along))
    return torch.cat([*columns, torch.ones(*histograms.shape[:-1], 1)], -1)


def _to_roots(histograms: Tensor, share: float) -> Tensor:
    """Histograms replaced by their square roots times those of ``share``.

    The roots are NumPy's: PyTorch's are slow at zeros, and most of a histogram is zero.
    """
    values = histograms.numpy()
    np.sqrt(values, out=values)
    return histograms if share == 1 else histograms.mul_(share**0.5)


def _doubled(direction: Tensor | None, along: float) -> Tensor:
    """Rows (..., 2) whose products are the direction term's similarity: unit vectors at twice the angle, weighed."""
    if direction is None:
        raise InputError("The cost weighs edge direction, but none is given; set direction_weight=0.")
    return torch.stack([torch.cos(2 * direction), torch.sin(2 * direction)], -1) * (along / 2) ** 0.5


def position_features(points: Tensor, cost: PairCost) -> Tensor:
    """Rows (..., 4) of a view whose products with `position_query` are squared distances in clamp units."""
    p = points / cost.position_clamp_px
    return torch.cat([p.square().sum(-1, keepdim=True), p, torch.ones_like(p[..., :1])], -1)


def position_query(points: Tensor, cost: PairCost) -> Tensor:
    """Rows (Pq, 4) of a query for `position_features`."""
    q = points / cost.position_clamp_px
    return torch.cat([torch.ones_like(q[..., :1]), -2 * q, q.square().sum(-1, keepdim=True)], -1)


def add_paired_chi2(out: Tensor, views: Tensor, queries: Tensor, share: float) -> None:
    """`add_chi2` for K pairs of a query and a view: costs (K, Pq, P), views (K, D, P), queries (K, Pq, D)."""
    for seen, asked in zip(views.unbind(1), queries.unbind(2), strict=True):
        both = (asked[:, :, None] + seen[:, None, :]).clamp_min_(1e-12)
        out.addcdiv_(asked.square()[:, :, None].expand_as(both), both, value=2 * share)
    out.sub_(share)


def add_chi2(out: Tensor, views: Tensor, query: Tensor, share: float) -> None:
    """Add ``share * 1/2 sum (a - b)^2 / (a + b)`` in place, exactly, for histograms that sum to 1.

    Then chi2 is ``2 sum a^2 / (a + b) - 1`` over the bins that the query's point fills (some 17 of 60), so
    each query point costs one gather, one addition, one reciprocal and one matrix-vector product.

    Args:
        out: (Pq, N) costs to add to.
        views: (D, N) histograms of the views' points, a column each.
        query: (Pq, D) histograms of the query's points.
        share: the term's weight.
    """
    filled = [row.nonzero().flatten() for row in query]
    buffer = torch.empty(max(len(f) for f in filled) * views.shape[1])
    for i, bins in enumerate(filled):
        a = query[i, bins]
        t = buffer[: len(bins) * views.shape[1]].view(len(bins), -1)
        torch.index_select(views, 0, bins, out=t)
        t.add_(a[:, None]).reciprocal_()
        out[i].addmv_(t.T, a.square(), alpha=2 * share).sub_(share)
