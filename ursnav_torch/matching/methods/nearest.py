"""Each point takes its cheapest counterpart: no assignment, the fastest and, for ranking, as good as any."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching.methods.base import Assignment, Correspondences


@dataclass(frozen=True, slots=True)
class Nearest:
    """Mean cost of the cheapest counterpart.

    Attributes:
        sides: "query_to_view" asks whether the view explains the query (edges missing in the query are
            free), "view_to_query" the reverse, "sum" adds both (Belongie et al. 2002, section 5.1).
        keep: share of the query's points that count, the best ones; below 1 it forgives clutter in the query.
            Points of the view are never dropped.

    The defaults name the right view most often when the query is seen in part or with clutter, as in
    ``python -m benchmarks.matching``.
    """

    sides: Literal["query_to_view", "view_to_query", "sum"] = "query_to_view"
    keep: float = 0.7

    def __post_init__(self) -> None:
        if self.sides not in ("query_to_view", "view_to_query", "sum"):
            raise InputError(f"sides is {self.sides!r}; accepted are 'query_to_view', 'view_to_query' and 'sum'.")
        if not 0 < self.keep <= 1:
            raise InputError(f"keep is a share of the points, above 0 and at most 1; got {self.keep}.")

    def reduce(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
        """See `Method.reduce`."""
        return self.combine(cost.amin(2), cost.amin(0), shares, weights)

    def combine(self, of_query: Tensor, of_views: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
        """Distances (V,) from the cheapest cost of each query point (Pq, V) and of each view's point (V, P)."""
        if self.sides == "view_to_query":
            return (of_views * shares).sum(1)
        there = trimmed_mean(of_query, weights, self.keep)
        return there if self.sides == "query_to_view" else there.add_((of_views * shares).sum(1))

    def finish(self, distances: Tensor, costs_of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Tensor:
        """Nothing is left to do; see `Method.finish`."""
        return distances

    def assign(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Assignment:
        """See `Method.assign`: each query point's cheapest counterpart, the best `keep` of them."""
        cheapest = torch.from_numpy(cost.numpy().argmin(2))
        best = cost.gather(2, cheapest[..., None])[..., 0]
        of_views = best.T if self.sides == "query_to_view" else cost.amin(0)  # nobody asks those
        distance, kept = self.combine(best, of_views, shares, weights), max(1, round(self.keep * len(best)))
        if kept == len(best):
            return Assignment(distance, cheapest.T, torch.ones(best.T.shape))
        strength = torch.zeros(best.T.shape).scatter_(1, best.T.topk(kept, 1, largest=False).indices, 1.0)
        return Assignment(distance, cheapest.T, strength)

    def pairs(self, cost: Tensor, weights: Tensor) -> Correspondences:
        """The cheapest counterpart of each query point, the best `keep` of them, cheapest first; see `Method.pairs`."""
        best, view = cost.min(1)
        kept = best.argsort()[: max(1, round(self.keep * len(best)))]
        return Correspondences(kept, view[kept], best[kept])


def trimmed_mean(best: Tensor, weights: Tensor, keep: float) -> Tensor:
    """Weighted mean (V,) of the cheapest rows of `best` (Pq, V) that make up the share `keep` of the weight."""
    if keep >= 1:
        return weights @ best
    rows, w = best.T.contiguous().numpy(), weights.numpy()
    if w.min() == w.max():
        return torch.from_numpy(_even_trimmed_mean(rows, keep * len(w)))
    order = np.argsort(rows, 1)  # NumPy's sorts are vectorized, PyTorch's are not
    w = w[order]
    used = np.minimum(np.maximum(keep - (np.cumsum(w, 1) - w), 0), w)
    return torch.from_numpy((used * np.take_along_axis(rows, order, 1)).sum(1) / np.float32(keep))


def _even_trimmed_mean(rows: NDArray[np.float32], count: float) -> NDArray[np.float32]:
    """Mean (V,) of the `count` smallest numbers of each row (V, N), the last of them in part."""
    whole = int(count)
    if whole >= rows.shape[1]:
        return rows.mean(1)
    ordered = np.partition(rows, whole, 1)
    return (ordered[:, :whole].sum(1) + np.float32(count - whole) * ordered[:, whole]) / np.float32(count)
