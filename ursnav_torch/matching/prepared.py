"""Views and queries laid out so that their pair costs come from matrix products."""

import math
import threading
from dataclasses import dataclass

import torch
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching import cost as pair_cost
from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext, describe
from ursnav_torch.matching.point_sets import ViewPoints


@dataclass(frozen=True, slots=True)
class PreparedQuery:
    """One query, ready to be multiplied.

    Attributes:
        histograms: (Pq, D) shape contexts.
        features: (Pq, F) rows for the product with the views' features.
        position: (Pq, 4) rows for the product with the views' positions.
    """

    histograms: Tensor
    features: Tensor
    position: Tensor


class PreparedViews:
    """Shape contexts and features of V views with P places for points each."""

    def __init__(self, views: ViewPoints, descriptor: ShapeContext, cost: PairCost) -> None:
        histograms = describe(views.points, views.mask, descriptor, views.direction, views.weights)
        self.descriptor, self.cost, self.mask = descriptor, cost, views.mask
        along = None if views.direction is None else views.direction.flatten()
        self._features = pair_cost.view_features(histograms.flatten(0, 1), along, views.mask.flatten(), cost)
        self._histograms = _columns(histograms) if cost.compare == "chi2" else None
        self._origin = views.center()
        position = pair_cost.position_features(views.points - self._origin, cost)
        self._position = _columns(position) if cost.position_weight > 0 else None
        self._shares = cost.shares()
        self._local = threading.local()

    def query(self, points: Tensor, direction: Tensor | None, weights: Tensor | None) -> PreparedQuery:
        """Prepare a query: points (Pq, 2) px, direction (Pq,) radians, weights (Pq,) as neighbors."""
        mask = torch.ones(1, len(points), dtype=torch.bool)
        tangents = None if direction is None else direction[None]
        neighbors = None if weights is None else weights[None]
        histograms = describe(points[None], mask, self.descriptor, tangents, neighbors)[0]
        return PreparedQuery(
            histograms,
            pair_cost.query_features(histograms, direction, self.cost),
            pair_cost.position_query(points - self._origin, self.cost),
        )

    def costs(self, query: PreparedQuery, part: slice) -> Tensor:
        """Costs (Pq, K, P) of the query's points against the views of a slice; ABSENT and more at no point.

        The result lies in a buffer that this thread's next call overwrites.
        """
        width = self.mask.shape[1]
        columns = slice(part.start * width, part.stop * width)
        out = self._buffer(len(query.features), columns.stop - columns.start)
        features = self._features[:, columns]
        if self._position is None:
            torch.mm(query.features, features, out=out)
        else:
            torch.mm(query.position, self._position[:, columns], out=out)
            out.clamp_(0.0, 1.0).sqrt_()
            torch.addmm(out, query.features, features, beta=self._shares[1], out=out)
        if self._histograms is not None:
            pair_cost.add_chi2(out, self._histograms[:, columns], query.histograms, self._shares[0])
        return out.view(len(out), -1, width)

    def minima(self, query: PreparedQuery, part: slice, step: int) -> tuple[Tensor, Tensor]:
        """Cheapest cost of each query point (Pq, K) and of each view's point (K, P), `step` views at a time."""
        of_query, of_views = [], torch.empty(part.stop - part.start, self.mask.shape[1])
        for start in range(part.start, part.stop, step):
            views = slice(start, min(start + step, part.stop))
            costs = self.costs(query, views)
            of_query.append(costs.amin(2))
            torch.amin(costs, 0, out=of_views[start - part.start : views.stop - part.start])
        return torch.cat(of_query, 1), of_views

    def costs_of(self, query: PreparedQuery, views: Tensor) -> Tensor:
        """`costs` of single views (K,), in memory of its own: (Pq, K, P)."""
        return torch.cat([self.costs(query, slice(v, v + 1)).clone() for v in views.tolist()], 1)

    def _buffer(self, rows: int, columns: int) -> Tensor:
        """A (rows, columns) piece of this thread's scratch memory, which is kept: fresh pages are slow."""
        kept: Tensor | None = getattr(self._local, "buffer", None)
        if kept is None or len(kept) < rows * columns:
            with torch.inference_mode(False):  # it outlives the mode it is made in
                kept = self._local.buffer = torch.empty(rows * columns)
        return kept[: rows * columns].view(rows, columns)


def _columns(rows: Tensor) -> Tensor:
    """Rows (V, P, F) as columns (F, V P), in which layout products are some 10 % faster."""
    return rows.flatten(0, 1).T.contiguous()


def compress(
    points: Tensor, direction: Tensor | None, weights: Tensor | None, mask: Tensor | None
) -> tuple[Tensor, Tensor | None, Tensor | None]:
    """Points (N, 2), direction and weights (N,) of a query without the rows that its mask rules out.

    Points of weight 0 stay: they may still be matched, they only count for nothing.

    Raises:
        InputError: weights below zero, or shapes that do not fit.
    """
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"A query's points must have shape (N, 2), got {tuple(points.shape)}.")
    for name, row in (("direction", direction), ("weights", weights), ("mask", mask)):
        if row is not None and row.shape != points.shape[:1]:
            raise InputError(f"A query's {name} must have shape ({len(points)},), got {tuple(row.shape)}.")
    if weights is not None and len(weights) and not float(weights.min()) >= 0:
        raise InputError(f"A query's weights must be >= 0, found {float(weights.min())}.")
    kept = slice(None) if mask is None else mask
    return (
        points[kept].float(),
        None if direction is None else direction[kept].float(),
        None if weights is None else weights[kept].float(),
    )


def turn(points: Tensor, direction: Tensor | None, roll: float, center: Tensor) -> tuple[Tensor, Tensor | None]:
    """Points (N, 2) and directions (N,) turned by `roll` radians, x towards y, about `center` (2,)."""
    if roll == 0.0:
        return points, direction
    c, s = math.cos(roll), math.sin(roll)
    rotation = torch.tensor([[c, s], [-s, c]])
    return (points - center) @ rotation + center, None if direction is None else direction + roll
