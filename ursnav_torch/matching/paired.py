"""Queries against one view each: views are described when they are first asked for, and kept."""

import torch
from torch import Tensor

from ursnav_torch.matching import cost as pair_cost
from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext, describe
from ursnav_torch.matching.point_sets import ViewPoints

#: Views whose descriptions are kept; beyond, all are forgotten and described anew as they are asked for.
_MOST_KEPT = 20_000


class PairedViews:
    """Views of which few are asked for at a time: a search's finalists.

    Preparing costs nothing; a view is described the first time it is a finalist.

    Memory: 4 V P (D + 3) bytes at most, V up to 20,000 (0.5 GB of 100 points), taken up as views are described.
    """

    def __init__(self, views: ViewPoints, descriptor: ShapeContext, cost: PairCost) -> None:
        self.descriptor, self.cost, self._views = descriptor, cost, views
        self._origin = views.center()
        self._described = torch.zeros(len(views.points), dtype=torch.bool)
        self._features: Tensor | None = None  # (V, F, P), rows filled as they are described
        self._histograms: Tensor | None = None  # (V, D, P), kept for exact chi2 alone

    def costs(self, points: Tensor, direction: Tensor | None, views: Tensor, weights: Tensor | None = None) -> Tensor:
        """Costs (Pq, K, P) of K queries, each against one view: one batched product for all of them.

        Args:
            points: (K, Pq, 2) px.
            direction: (K, Pq) radians, or None.
            views: (K,) int64.
            weights: (Pq,) how much a query's point counts as a neighbor, in all K alike; 1 where left out.
        """
        self._describe(views)
        assert self._features is not None
        mask = torch.ones(points.shape[:2], dtype=torch.bool)
        neighbors = None if weights is None else weights.expand(len(points), -1)
        histograms = describe(points, mask, self.descriptor, direction, neighbors)
        cost = torch.bmm(pair_cost.query_features(histograms, direction, self.cost), self._features[views])
        _, share, _ = self.cost.shares()
        if share > 0:
            there = pair_cost.position_features(self._views.points[views] - self._origin, self.cost).transpose(1, 2)
            far = torch.bmm(pair_cost.position_query(points - self._origin, self.cost), there)
            cost.add_(far.clamp_(0.0, 1.0).sqrt_(), alpha=share)
        if self._histograms is not None:
            pair_cost.add_paired_chi2(cost, self._histograms[views], histograms, self.cost.shares()[0])
        return cost.transpose(0, 1)

    def _describe(self, views: Tensor) -> None:
        """Describe those of the views (K,) that no one asked for before."""
        new = views[~self._described[views]].unique()
        if not len(new):
            return
        if int(self._described.sum()) + len(new) > _MOST_KEPT:
            self._described.zero_()
            self._features = self._histograms = None
            new = views.unique()
        some = self._views.at(new)
        histograms = describe(some.points, some.mask, self.descriptor, some.direction, some.weights)
        features = pair_cost.view_features(histograms, some.direction, some.mask, self.cost)
        if self._features is None:
            with torch.inference_mode(False):  # they outlive the mode they are made in
                self._features = torch.empty(len(self._described), *features.shape[1:])
                if self.cost.compare == "chi2":
                    self._histograms = torch.empty(len(self._described), histograms.shape[2], histograms.shape[1])
        self._features[new] = features
        if self._histograms is not None:
            self._histograms[new] = histograms.transpose(1, 2)
        self._described[new] = True
