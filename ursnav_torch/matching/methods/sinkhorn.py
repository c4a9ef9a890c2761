"""Entropic optimal transport between point sets, batched over views (Cuturi, NeurIPS 2013)."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching.cost import ABSENT
from ursnav_torch.matching.methods.base import Assignment, Correspondences

_TINY = 1e-30


class ConvergenceWarning(UserWarning):
    """Sinkhorn stopped before its marginals were right."""


@dataclass(frozen=True, slots=True)
class Transport:
    """A batch of transport plans.

    Attributes:
        cost: (V,) transport cost <plan, cost>.
        plan: (Pq, V, P) mass moved from query point to view point; 1 in total for each view.
        marginal_error: (V,) sum over query points of |mass that left - mass that should have|.
    """

    cost: Tensor
    plan: Tensor
    marginal_error: Tensor


@dataclass(frozen=True, slots=True)
class Sinkhorn:
    """Transport cost with an entropy term.

    Attributes:
        epsilon: weight of the entropy, in units of the cost (0 to 1); smaller is sharper and slower.
        iterations: at most this many.
        tolerance: marginal error at which to stop. A `ConvergenceWarning` tells of a view that is not there
            after the last iteration; infinity runs all iterations and never warns.
        domain: "plain" is fastest; "log" holds for any epsilon.
        dummy_cost: cost of leaving a point unmatched, of the query (clutter) or of the view (an edge that is missing
            in the query): either set gets a dummy that takes any of the other's mass at this price, so that a pair
            dearer than two dummies is none. None matches all mass.
        double: compute in float64.
    """

    epsilon: float = 0.05
    iterations: int = 200
    tolerance: float = 1e-2
    domain: Literal["plain", "log"] = "plain"
    dummy_cost: float | None = None
    double: bool = False

    def __post_init__(self) -> None:
        if self.dummy_cost is not None and not self.dummy_cost > 0:
            raise InputError(f"dummy_cost must be > 0, or null for no dummies; got {self.dummy_cost}.")
        if not self.epsilon > 0 or self.iterations < 1 or not self.tolerance > 0:
            raise InputError(
                f"Sinkhorn needs epsilon > 0, iterations >= 1 and tolerance > 0, "
                f"got {self.epsilon}, {self.iterations} and {self.tolerance}."
            )
        if self.domain not in ("plain", "log"):
            raise InputError(f"domain is {self.domain!r}; accepted are 'plain' and 'log'.")

    def reduce(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
        """See `Method.reduce`."""
        return self.transport(cost, shares, weights).cost.float()

    def finish(self, distances: Tensor, costs_of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Tensor:
        """Nothing is left to do; see `Method.finish`."""
        return distances

    def assign(self, cost: Tensor, shares: Tensor, weights: Tensor) -> Assignment:
        """See `Method.assign`: the transport plan's largest entry of each query point, as a share of its mass.

        Mass that goes to a dummy is the query point's, too: clutter has little strength.
        """
        moved = self.transport(cost, shares, weights)
        mass, view_point = moved.plan.max(2)
        strength = mass / weights.clamp_min(_TINY)[:, None]
        return Assignment(moved.cost.float(), view_point.T, strength.T.float())

    def pairs(self, cost: Tensor, weights: Tensor) -> Correspondences:
        """The view point that receives most of each query point's mass; see `Method.pairs`."""
        even = torch.full((1, cost.shape[1]), 1 / cost.shape[1])
        view = self.transport(cost[:, None], even, weights).plan[:, 0].argmax(1)
        query = torch.arange(len(cost))
        return Correspondences(query, view, cost[query, view])

    def _with_dummies(
        self, solve: Callable[[Tensor, Tensor, Tensor, "Sinkhorn"], Transport], cost: Tensor, target: Tensor,
        source: Tensor,
    ) -> Transport:  # fmt: skip
        """The plan between the points alone; what leaving points unmatched costs is part of the cost."""
        if self.dummy_cost is None:
            return solve(cost, target, source, self)
        found = solve(*_augmented(cost, target, source, self.dummy_cost), self)
        return Transport(found.cost, found.plan[:-1, :, :-1], found.marginal_error)

    def transport(self, cost: Tensor, target: Tensor, weights: Tensor) -> Transport:
        """Plans from query points to the points of each view.

        Args:
            cost: (Pq, V, P).
            target: (V, P) masses of the views' points, zero where there is none; scaled to sum to 1.
            weights: (Pq,) masses of the query's points; scaled to sum to 1.
        """
        dtype = torch.float64 if self.double else torch.float32
        target = target.to(dtype) / target.to(dtype).sum(1, keepdim=True)
        source = weights.to(dtype) / weights.to(dtype).sum()
        solve = _plain if self.domain == "plain" else _log
        result = self._with_dummies(solve, cost.to(dtype), target, source)
        worst = float(result.marginal_error.nan_to_num().max()) if len(target) else 0.0
        if worst > self.tolerance:
            warnings.warn(
                f"Sinkhorn stopped after {self.iterations} iterations with a marginal error of {worst:.1e} "
                f"(tolerance {self.tolerance:.1e}); raise iterations or epsilon, or choose domain='log'.",
                ConvergenceWarning,
                stacklevel=2,
            )
        return result


def _augmented(cost: Tensor, target: Tensor, weights: Tensor, dummy_cost: float) -> tuple[Tensor, Tensor, Tensor]:
    """Costs (Pq + 1, V, P + 1), target (V, P + 1) and weights (Pq + 1,) with a dummy on either side.

    A dummy holds as much mass as all of the other side's points; dummy to dummy is free.
    """
    wide = torch.nn.functional.pad(cost, (0, 1, 0, 0, 0, 1), value=dummy_cost)
    wide[-1, :, -1] = 0.0
    wide[-1, :, :-1].masked_fill_(target <= 0, ABSENT)
    ones = torch.ones(len(target), 1, dtype=target.dtype)
    return wide, torch.cat([target, ones], 1), torch.cat([weights, weights.new_ones(1)])


def _plain(cost: Tensor, target: Tensor, weights: Tensor, settings: Sinkhorn) -> Transport:
    """Scaling iterations on ``exp(-cost / epsilon)``: two batched matrix-vector products each.

    Those are NumPy's: PyTorch's batched product is slow where one factor has a single column.
    """
    kernel = (cost.transpose(0, 1) / -settings.epsilon).contiguous().exp_()  # (V, Pq, P)
    K, sent, wanted = kernel.numpy(), weights.numpy(), target.numpy()
    left = K.sum(2)
    with np.errstate(all="ignore"):  # a view without points has no masses: its row is nan
        for step in range(1, settings.iterations + 1):
            u = sent / np.maximum(left, _TINY)
            v = wanted / np.maximum((u[:, None] @ K)[:, 0], _TINY)
            left = (K @ v[:, :, None])[:, :, 0]
            if _last(step, settings):
                error = np.abs(u * left - sent).sum(1)
                if step == settings.iterations or np.nan_to_num(error).max(initial=0) <= settings.tolerance:
                    break
    plan = kernel.mul_(torch.from_numpy(v)[:, None]).mul_(torch.from_numpy(u)[:, :, None]).transpose(0, 1)
    return Transport((plan * cost).sum((0, 2)), plan, torch.from_numpy(error))


def _log(cost: Tensor, target: Tensor, weights: Tensor, settings: Sinkhorn) -> Transport:
    """The same iterations on the potentials, which cannot under- or overflow."""
    kernel = cost / -settings.epsilon
    log_source, log_target = weights.clamp_min(_TINY).log()[:, None], target.clamp_min(_TINY).log()
    log_target = torch.where(target > 0, log_target, -torch.inf)
    g = torch.where(target > 0, torch.zeros_like(target), -torch.inf)
    for step in range(1, settings.iterations + 1):
        f = log_source - (kernel + g).logsumexp(2)
        g = log_target - (kernel + f[:, :, None]).logsumexp(0)
        if _last(step, settings):
            error = ((kernel + g).logsumexp(2).add_(f).exp_() - weights[:, None]).abs().sum(0)
            if step == settings.iterations or float(error.nan_to_num().max()) <= settings.tolerance:
                break
    plan = (kernel + g + f[:, :, None]).exp_()
    return Transport((plan * cost).sum((0, 2)), plan, error)


def _last(step: int, settings: Sinkhorn) -> bool:
    """Whether the marginals are looked at after this step: every tenth and the last."""
    return step == settings.iterations or (step % 10 == 0 and settings.tolerance < torch.inf)
