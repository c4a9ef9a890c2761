"""Queries against one view each: views are described when they are first asked for, and kept."""

import torch
from torch import Tensor

from ursnav_torch.matching import cost as pair_cost
from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext, describe


class PairedViews:
    """Views of which few are asked for at a time: a search's finalists.

    Preparing costs nothing; a view is described the first time it is a finalist. See `Matcher` for the arguments.

    Memory: 4 V P (D + 3) bytes at most, taken up as views are described.
    """

    def __init__(
        self,
        points: Tensor,
        mask: Tensor,
        direction: Tensor | None,
        weights: Tensor | None,
        descriptor: ShapeContext,
        cost: PairCost,
    ) -> None:
        self.descriptor, self.cost = descriptor, cost
        self._points, self._mask, self._direction, self._weights = points, mask, direction, weights
        self._origin = points[mask].mean(0) if bool(mask.any()) else torch.zeros(2)
        self._described = torch.zeros(len(points), dtype=torch.bool)
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
            there = pair_cost.position_features(self._points[views] - self._origin, self.cost).transpose(1, 2)
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
        along = None if self._direction is None else self._direction[new]
        neighbors = None if self._weights is None else self._weights[new]
        histograms = describe(self._points[new], self._mask[new], self.descriptor, along, neighbors)
        features = pair_cost.view_features(histograms, along, self._mask[new], self.cost).transpose(1, 2)
        if self._features is None:
            with torch.inference_mode(False):  # they outlive the mode they are made in
                self._features = torch.empty(len(self._points), *features.shape[1:])
                if self.cost.compare == "chi2":
                    self._histograms = torch.empty(len(self._points), histograms.shape[2], histograms.shape[1])
        self._features[new] = features
        if self._histograms is not None:
            self._histograms[new] = histograms.transpose(1, 2)
        self._described[new] = True
