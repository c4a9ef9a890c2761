"""What the ways of turning a cost matrix into one distance have in common."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Points of a query and the points of one view that they were matched to, K pairs.

    Attributes:
        query: (K,) int64 rows of the query's points.
        view: (K,) int64 rows of the view's points.
        cost: (K,) float32 pair costs, 0 to 1, lower is better.
    """

    query: Tensor
    view: Tensor
    cost: Tensor


@dataclass(frozen=True, slots=True)
class Assignment:
    """K queries of Pq points each, and how the points of one view each are assigned to theirs.

    Attributes:
        distance: (K,) float32, lower is nearer; inf for a view without points.
        view_point: (K, Pq) int64, the view's point that most of a query point's mass goes to.
        strength: (K, Pq) float32 in 0..1, the share of the query point's mass that goes there; 0 where the query's
            point is left out.
    """

    distance: Tensor
    view_point: Tensor
    strength: Tensor


class Method(Protocol):
    """A way from costs to distances. Costs are laid out (Pq, V, P): query point, view, the view's point."""

    def reduce(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
        """Distances (V,) from costs (Pq, V, P), which may be overwritten.

        Args:
            cost: (Pq, V, P), at least `cost.ABSENT` where a view has no point.
            shares: (V, P) even weights of a view's points that sum to 1, zero where it has none.
            weights: (Pq,) weights of the query's points that sum to 1.
        """

    def finish(self, distances: Tensor, costs_of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Tensor:
        """Final distances (V,) when all views were reduced; `costs_of(views)` gives (Pq, K, P) and mask (K, P)."""

    def assign(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Assignment:
        """Final distances and soft correspondences of K query-view pairs from their costs (Pq, K, P), all at once.

        Args:
            cost, shares, weights: as `reduce` takes them, V = K; every view has a point, the costs are kept.
        """

    def pairs(self, cost: Tensor, weights: Tensor) -> Correspondences:
        """Correspondences from one view's costs (Pq, N), all of them real points."""
