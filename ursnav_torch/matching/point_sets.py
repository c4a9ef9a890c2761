"""Ragged point sets as one padded tensor and a mask."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from ursnav_torch.errors import InputError, ShapeError


@dataclass(frozen=True, slots=True)
class PointSets:
    """B point sets padded to P points.

    Attributes:
        points: (B, P, 2) float32 in px, zero where there is no point.
        mask: (B, P) bool, true where there is a point; the points of a set come first.
    """

    points: Tensor
    mask: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class ViewPoints:
    """Edge points of V views, padded to P places for points each.

    Attributes:
        points: (V, P, 2) float32 in px.
        mask: (V, P) bool, true where there is a point.
        direction: (V, P) edge direction in radians, x towards y, or None.
        weights: (V, P) how much a point counts as a neighbor, >= 0; None for 1.
    """

    points: Tensor
    mask: Tensor
    direction: Tensor | None = None
    weights: Tensor | None = None

    def at(self, views: Tensor) -> "ViewPoints":
        """Those of some views (K,), in that order."""
        along = None if self.direction is None else self.direction[views]
        return ViewPoints(
            self.points[views], self.mask[views], along, None if self.weights is None else self.weights[views]
        )

    def center(self) -> Tensor:
        """The mean (2,) of all points, zero where there are none."""
        return self.points[self.mask].mean(0) if bool(self.mask.any()) else torch.zeros(2)


def as_points(points: ArrayLike | Tensor, name: str = "points") -> Tensor:
    """One point set (N, 2) as a float32 tensor; an empty list is an empty set.

    Raises:
        ShapeError: not (N, 2).
        InputError: a coordinate is not finite.
    """
    tensor = torch.as_tensor(points if isinstance(points, Tensor) else np.asarray(points, np.float32))
    if tensor.numel() == 0:
        return torch.zeros(0, 2)
    if tensor.ndim != 2 or tensor.shape[1] != 2:
        raise ShapeError(f"{name} must have shape (N, 2), x and y in px, got {tuple(tensor.shape)}.")
    if not torch.isfinite(tensor).all():
        raise InputError(f"{name} holds a coordinate that is not finite; drop such points first.")
    return tensor.to(torch.float32)


def pack(sets: Sequence[ArrayLike | Tensor]) -> PointSets:
    """Pad B point sets (N_b, 2) to `PointSets` (B, max N_b, 2); at least one column wide."""
    tensors = [as_points(s, f"point set {i}") for i, s in enumerate(sets)]
    width = max((len(t) for t in tensors), default=0)
    points = torch.zeros(len(tensors), max(width, 1), 2)
    mask = torch.zeros(len(tensors), max(width, 1), dtype=torch.bool)
    for i, t in enumerate(tensors):
        points[i, : len(t)] = t
        mask[i, : len(t)] = True
    return PointSets(points, mask)


def pack_rows(rows: Sequence[ArrayLike | Tensor], like: PointSets) -> Tensor:
    """Pad one number a point (N_b,) to (B, P) float32 beside `like`; zero where there is no point.

    Raises:
        ShapeError: a row has another length than its point set.
    """
    out = torch.zeros(like.mask.shape)
    for i, row in enumerate(rows):
        tensor = torch.as_tensor(row if isinstance(row, Tensor) else np.asarray(row, np.float32)).reshape(-1)
        count = int(like.mask[i].sum())
        if len(tensor) != count:
            raise ShapeError(f"Set {i} has {count} points but {len(tensor)} numbers beside them; give one a point.")
        out[i, :count] = tensor.to(torch.float32)
    return out
