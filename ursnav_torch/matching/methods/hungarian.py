"""One-to-one assignment, exact, on as few views as a lower bound allows."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching.methods.base import Assignment, Correspondences

#: Views whose costs are computed again at once while solving.
_BATCH = 8


@dataclass(frozen=True, slots=True)
class Hungarian:
    """Mean cost of the pairs of an optimal assignment of min(query points, view points) pairs.

    Query weights do not enter: a pair is a pair.

    Attributes:
        exact: how many of the nearest views are certain to carry their exact distance; None for all. A view
            that can no longer come among them keeps its lower bound, which is no nearer than any of those.
        double: solve on float64 costs.
    """

    exact: int | None = 1
    double: bool = False

    def __post_init__(self) -> None:
        if self.exact is not None and self.exact < 1:
            raise InputError(f"exact must be at least 1, or null for all views; got {self.exact}.")

    def reduce(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
        """Lower bounds (V,) of the mean assignment cost; see `Method.reduce`."""
        return assignment_bound(cost, shares > 0)

    def finish(self, distances: Tensor, costs_of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Tensor:
        """Solve views in order of their bounds until no bound is below the `exact`-th best; see `Method.finish`."""
        out = distances.clone()
        order = distances.argsort(stable=True)
        order = order[torch.isfinite(distances[order])]
        wanted = len(order) if self.exact is None else min(self.exact, len(order))
        solved: list[float] = []
        for start in range(0, len(order), _BATCH):
            batch = order[start : start + _BATCH]
            if _settled(solved, wanted, float(distances[batch[0]])):
                break
            cost, mask = costs_of(batch)
            for k, view in enumerate(batch.tolist()):
                if _settled(solved, wanted, float(distances[view])):
                    break
                out[view] = float(self._solve(cost[:, k, mask[k]])[2].mean())
                solved.append(float(out[view]))
        return out

    def assign(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Assignment:
        """See `Method.assign`: every pair solved exactly, whatever `exact` says; SciPy solves one at a time."""
        queries, views = cost.shape[:2]
        distance, view_point = torch.empty(views), torch.zeros(views, queries, dtype=torch.long)
        strength = torch.zeros(views, queries)
        for k, mask in enumerate(shares > 0):
            rows, columns, costs = self._solve(cost[:, k, mask])
            distance[k] = float(costs.mean())
            view_point[k, rows], strength[k, rows] = mask.nonzero().flatten()[columns], 1.0
        return Assignment(distance, view_point, strength)

    def pairs(self, cost: Tensor, weights: Tensor) -> Correspondences:
        """The optimal assignment; see `Method.pairs`."""
        rows, columns, costs = self._solve(cost)
        return Correspondences(torch.as_tensor(rows), torch.as_tensor(columns), torch.as_tensor(costs).float())

    def _solve(self, cost: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        matrix = cost.numpy().astype(np.float64 if self.double else np.float32)
        rows, columns = linear_sum_assignment(matrix)
        return rows, columns, matrix[rows, columns]


def _settled(solved: list[float], wanted: int, bound: float) -> bool:
    """Whether no view with at least this bound can come among the `wanted` best."""
    return len(solved) >= wanted and bound >= sorted(solved)[wanted - 1]


def assignment_bound(cost: Tensor, mask: Tensor) -> Tensor:
    """Lower bound (V,) of the mean cost of the pairs in an optimal assignment.

    Of k = min(Pq, N) pairs each costs at least its row's minimum and at least its column's, so the mean of the
    k smallest row minima and that of the k smallest column minima are both bounds.

    Args:
        cost: (Pq, V, P), large where the view has no point.
        mask: (V, P) bool.
    """
    pairs = mask.sum(1).clamp_max(len(cost))
    rows = _smallest_mean(cost.amin(2).T, pairs)
    columns = _smallest_mean(cost.amin(0).masked_fill(~mask, torch.inf), pairs)
    return torch.maximum(rows, columns)


def _smallest_mean(values: Tensor, count: Tensor) -> Tensor:
    """Mean (V,) of the `count` (V,) smallest numbers of each row of `values` (V, N)."""
    if bool((count == values.shape[1]).all()):
        return values.mean(1)
    ordered = values.sort(1).values
    inside = torch.arange(values.shape[1]) < count[:, None]
    return torch.where(inside, ordered, 0.0).sum(1) / count
