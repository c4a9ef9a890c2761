"""A view database prepared once, and queries against it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import torch
from torch import Tensor

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext, fix_scale
from ursnav_torch.matching.methods.base import Assignment, Correspondences, Method
from ursnav_torch.matching.methods.nearest import Nearest
from ursnav_torch.matching.methods.opencv import OpenCV
from ursnav_torch.matching.paired import PairedViews
from ursnav_torch.matching.point_sets import ViewPoints
from ursnav_torch.matching.prepared import PreparedQuery, PreparedViews, compress, turn
from ursnav_torch.threads import map_chunks, one_thread_an_operation

#: Numbers in one cost chunk, so that it and its views' features stay in the second-level cache.
_COSTS_A_CHUNK = 250_000
#: The same where only minima are kept: the smaller the chunk, the faster they are found.
_MINIMA_A_CHUNK = 100_000
#: Chunks of minima whose distances are made in one go.
_CHUNKS_A_PART = 40
#: The same for exact chi2, whose many short operations a query point want longer rows.
_CHI2_COSTS_A_CHUNK = 1_000_000


@dataclass(frozen=True, slots=True)
class Matching:
    """Everything that says how a query is compared with views.

    Attributes:
        descriptor: the shape context.
        cost: what a pair of points costs.
        method: how costs become one distance: `Nearest`, `Sinkhorn`, `Hungarian` or `OpenCV` (which brings a
            descriptor and cost of its own).
        roll_deg: rolls by which the query is turned (x towards y); the nearest of them counts.
    """

    descriptor: ShapeContext = field(default_factory=ShapeContext)
    cost: PairCost = field(default_factory=PairCost)
    method: Method | OpenCV = field(default_factory=Nearest)
    roll_deg: Sequence[float] = (0.0,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "roll_deg", tuple(self.roll_deg))  # a list from a file is welcome
        if not self.roll_deg:
            raise InputError("roll_deg is empty; give at least one roll, e.g. [0].")
        if len(self.roll_deg) > 1 and isinstance(self.method, OpenCV):
            raise InputError("matching=opencv has no roll search; set roll_deg=[0].")


class Matcher:
    """Distances and correspondences between a query and the views of a database.

    Args:
        points: (V, P, 2) px, the views' edge points.
        mask: (V, P) bool, true where there is a point.
        direction: (V, P) edge direction in radians, x towards y; needed in the tangent frame or when the cost
            weighs it (then modulo pi).
        settings: how to compare.
        weights: (V, P) how much a view's point counts as a neighbor, >= 0; 1 where left out.
        roll_center_px: (x, y) about which `settings.roll_deg` turns a query: the optical axis.

    Memory is about 4 V P (D + 10) bytes, 56 MB for 2,000 views of 100 points, once all views were compared.
    """

    def __init__(
        self,
        points: Tensor,
        mask: Tensor,
        direction: Tensor | None = None,
        settings: Matching | None = None,
        *,
        weights: Tensor | None = None,
        roll_center_px: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        settings = settings or Matching()
        if points.ndim != 3 or points.shape[2] != 2 or mask.shape != points.shape[:2]:
            raise ShapeError(
                f"Expected points (V, P, 2) and mask (V, P), got {tuple(points.shape)} and {tuple(mask.shape)}."
            )
        self.settings, self.points, self.mask = settings, points.float(), mask
        self._empty = ~mask.any(1)
        self._shares = mask / mask.sum(1, keepdim=True).clamp_min(1)
        self._roll_center = torch.tensor(roll_center_px, dtype=torch.float32)
        self._descriptor = fix_scale(settings.descriptor, self.points, mask)
        self._views_points = ViewPoints(self.points, mask, direction, weights)
        if isinstance(settings.method, OpenCV):
            settings.method.extractor()
        self.paired = PairedViews(self._views_points, self._descriptor, settings.cost)
        if (settings.cost.shares()[2] > 0 and direction is None) or settings.descriptor.frame == "tangent":
            _ = self.views  # so that what is missing is told at once

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def views(self) -> PreparedViews:
        """All views described at once, when the first query is compared with all of them."""
        with torch.inference_mode(False):  # they outlive the mode they are asked for in
            return PreparedViews(self._views_points, self._descriptor, self.settings.cost)

    def distances(
        self,
        points: Tensor,
        direction: Tensor | None = None,
        weights: Tensor | None = None,
        mask: Tensor | None = None,
    ) -> Tensor:
        """Distance of a query to every view.

        Args:
            points: (Pq, 2) px.
            direction: (Pq,) edge direction in radians, as the database's.
            weights: (Pq,) how much a point counts, >= 0, by itself and as a neighbor; 1 where left out.
            mask: (Pq,) bool, true where there is a point; all where left out.

        Returns:
            (V,) float32, lower is nearer; inf for views without points, for all if the query has none.
        """
        points, direction, weights = compress(points, direction, weights, mask)
        return self._at_rolls(points, direction, weights).amin(0)

    def nearest_rolls(self, points: Tensor, direction: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Distance (V,) of a query to every view as `distances` has it, and the roll (V,) in radians it has there.

        Args:
            points, direction: see `distances`. Turned by the roll, x towards y, the query is nearest to the view.
        """
        rolls = torch.tensor(self.settings.roll_deg, dtype=torch.float64).deg2rad()
        if len(rolls) == 1:
            return self.distances(points, direction), rolls.expand(len(self))
        distance, row = self._at_rolls(points, direction, None).min(0)
        return distance, rolls[row]

    def assign(
        self, points: Tensor, direction: Tensor | None, views: Tensor, weights: Tensor | None = None
    ) -> Assignment:
        """K queries of as many points, each assigned to one view, all at once and exactly.

        Args:
            points: (K, Pq, 2) px; `settings.roll_deg` plays no part.
            direction: (K, Pq) edge direction in radians, as the database's, or None.
            views: (K,) int64.
            weights: (Pq,) how much a query's point counts, >= 0, in all K alike; 1 where left out.

        Returns:
            Distances of inf for views without points, and for all if the queries have none. With `OpenCV`, whose
            extractor keeps its correspondences to itself, they are the nearest in our cost.
        """
        count, size = points.shape[:2]
        out = Assignment(torch.full((count,), math.inf), torch.zeros(count, size, dtype=torch.long),
                         torch.zeros(count, size))  # fmt: skip
        known = (~self._empty[views]).nonzero().flatten()
        shares = _shares(points[0], weights) if count else None
        if shares is None or not len(known):
            return out
        own = self.settings.method
        method = Nearest(keep=1.0) if isinstance(own, OpenCV) else own
        along = None if direction is None else direction[known]
        cost = self.paired.costs(points[known], along, views[known], weights)
        found = method.assign(cost, self._shares[views[known]], shares)
        distance = found.distance
        if isinstance(own, OpenCV):
            pairs = zip(points[known], views[known].tolist(), strict=True)
            distance = torch.cat([own.distances(p, self.points[[v]], self.mask[[v]]) for p, v in pairs])
        out.distance[known] = distance.clamp_min(0.0)
        out.view_point[known], out.strength[known] = found.view_point, found.strength
        return out

    def match(
        self,
        points: Tensor,
        view_indices: Tensor | list[int],
        direction: Tensor | None = None,
        weights: Tensor | None = None,
        mask: Tensor | None = None,
    ) -> list[Correspondences]:
        """Correspondences of a query with each view asked for, at the roll of lowest mean cost there.

        Arguments are those of `distances`. Rows count as the points were given, mask or not. With `OpenCV`,
        whose extractor keeps its correspondences to itself, they are the nearest in our cost.
        """
        rows = torch.arange(len(points)) if mask is None else mask.nonzero().flatten()
        points, direction, weights = compress(points, direction, weights, mask)
        shares = _shares(points, weights)
        views = torch.as_tensor(view_indices, dtype=torch.long).reshape(-1).tolist()
        with one_thread_an_operation():
            queries = [] if shares is None else self._queries(points, direction, weights)
            return [self._pairs(queries, view, shares, rows) for view in views]

    def _at_rolls(self, points: Tensor, direction: Tensor | None, weights: Tensor | None) -> Tensor:
        """Distances (rolls, V) of a query."""
        shares = _shares(points, weights)
        if shares is None or not len(self):
            return torch.full((len(self.settings.roll_deg), len(self)), math.inf)
        if isinstance(self.settings.method, OpenCV):
            return self.settings.method.distances(points, self.points, self.mask)[None]
        with torch.inference_mode():  # spares the many small operations their bookkeeping
            with one_thread_an_operation():
                queries = self._queries(points, direction, weights)
            return self._reduce(queries, shares).clamp_min_(0.0)

    def _queries(self, points: Tensor, direction: Tensor | None, weights: Tensor | None) -> list[PreparedQuery]:
        """The query at every roll."""
        turned = [turn(points, direction, math.radians(r), self._roll_center) for r in self.settings.roll_deg]
        return [self.views.query(p, d, weights) for p, d in turned]

    def _reduce(self, queries: list[PreparedQuery], shares: Tensor) -> Tensor:
        """Distances (rolls, V)."""
        method = self.settings.method
        assert not isinstance(method, OpenCV)
        out = torch.empty(len(queries), len(self))
        width = self.mask.shape[1] * len(shares)

        step = max(1, _MINIMA_A_CHUNK // width)
        keep_minima = method if isinstance(method, Nearest) and self.settings.cost.compare == "hellinger" else None

        def work(part: slice) -> None:
            for row, query in zip(out, queries, strict=True):
                if keep_minima is not None:
                    minima = self.views.minima(query, part, step)
                    row[part] = keep_minima.combine(*minima, self._shares[part], shares)
                else:
                    row[part] = method.reduce(self.views.costs(query, part), self._shares[part], shares)

        operations = float(len(queries) * len(self) * width * (self.views.descriptor.size + 10))
        chunk = _COSTS_A_CHUNK if self.settings.cost.compare == "hellinger" else _CHI2_COSTS_A_CHUNK
        views_a_part = step * _CHUNKS_A_PART if keep_minima else max(1, chunk // width)
        map_chunks(work, len(self), views_a_part, operations)
        for row, query in zip(out, queries, strict=True):
            row.masked_fill_(self._empty, math.inf)
            row.copy_(method.finish(row, partial(self._costs_and_mask, query)))
        return out

    def _costs_and_mask(self, query: PreparedQuery, views: Tensor) -> tuple[Tensor, Tensor]:
        return self.views.costs_of(query, views), self.mask[views]

    def _pairs(self, queries: list[PreparedQuery], view: int, shares: Tensor | None, rows: Tensor) -> Correspondences:
        """Correspondences with one view at its best roll."""
        columns = self.mask[view].nonzero().flatten()
        if shares is None or not len(columns):
            nothing = torch.zeros(0, dtype=torch.long)
            return Correspondences(nothing, nothing, torch.zeros(0))
        method = Nearest(keep=1.0) if isinstance(self.settings.method, OpenCV) else self.settings.method
        costs = [self.views.costs_of(q, torch.tensor([view]))[:, 0, columns] for q in queries]
        found = min((method.pairs(c, shares) for c in costs), key=lambda pairs: float(pairs.cost.mean()))
        return Correspondences(rows[found.query], columns[found.view], found.cost)


def _shares(points: Tensor, weights: Tensor | None) -> Tensor | None:
    """Weights (Pq,) that sum to 1; None if no point counts."""
    if not len(points):
        return None
    if weights is None:
        return torch.full((len(points),), 1 / len(points))
    total = weights.sum()
    return weights / total if float(total) > 0 else None
