"""Each point takes its cheapest counterpart: no assignment, the fastest and, for ranking, as good as any."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching.methods import Correspondences


@dataclass(frozen=True, slots=True)
class Nearest:
    """Mean cost of the cheapest counterpart.

    Attributes:
        sides: "query_to_view" asks whether the view explains the query (edges missing in the query are
            free), "view_to_query" the reverse, "sum" adds both (Belongie et al. 2002, section 5.1).
        keep: share of the query's points that count, the best ones; below 1 it forgives clutter in the query.
            Points of the view are never dropped.
    """

    sides: Literal["query_to_view", "view_to_query", "sum"] = "sum"
    keep: float = 1.0

    def __post_init__(self) -> None:
        if self.sides not in ("query_to_view", "view_to_query", "sum"):
            raise InputError(f"sides is {self.sides!r}; accepted are 'query_to_view', 'view_to_query' and 'sum'.")
        if not 0 < self.keep <= 1:
            raise InputError(f"keep is a share of the points, above 0 and at most 1; got {self.keep}.")

    def reduce(self, cost: Tensor, mask: Tensor, weights: Tensor) -> Tensor:
        """See `Method.reduce`."""
        out = torch.zeros(cost.shape[1])
        if self.sides != "view_to_query":
            out += trimmed_mean(cost.amin(2), weights, self.keep)
        if self.sides != "query_to_view":
            count = mask.sum(1)
            out += torch.where(mask, cost.amin(0), 0.0).sum(1) / count
        return out

    def finish(self, distances: Tensor, costs_of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Tensor:
        """Nothing is left to do."""
        return distances

    def pairs(self, cost: Tensor, weights: Tensor) -> Correspondences:
        """The cheapest counterpart of each query point, the best `keep` of them, cheapest first."""
        best, view = cost.min(1)
        kept = best.argsort()[: max(1, round(self.keep * len(best)))]
        return Correspondences(kept, view[kept], best[kept])


def trimmed_mean(best: Tensor, weights: Tensor, keep: float) -> Tensor:
    """Weighted mean (V,) of the cheapest rows of `best` (Pq, V) that make up the share `keep` of the weight."""
    if keep >= 1:
        return weights @ best
    ordered, order = best.sort(0)
    w = weights[order]
    used = (keep - (w.cumsum(0) - w)).clamp_min_(0).minimum(w)
    return (used * ordered).sum(0) / keep
