"""Ragged point sets as one padded tensor and a mask."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
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
        return (self.points * self.mask[..., None]).sum((0, 1)) / self.mask.sum().clamp_min(1)


def pack(sets: Sequence[ArrayLike | Tensor]) -> PointSets:
    """Pad B point sets (N_b, 2) to `PointSets` (B, max N_b, 2); at least one column wide.

    Raises:
        ShapeError: a set that is not (N, 2); an empty list is an empty set.
        InputError: a coordinate is not finite.
    """
    rows = [_as_rows(s, i) for i, s in enumerate(sets)]
    counts = torch.tensor([len(r) for r in rows], dtype=torch.long)
    width = max(int(counts.max()) if rows else 0, 1)
    every = np.concatenate(rows) if rows else np.zeros((0, 2), np.float32)
    if not np.isfinite(every).all():
        i = next(i for i, r in enumerate(rows) if not np.isfinite(r).all())
        raise InputError(f"point set {i} holds a coordinate that is not finite; drop such points first.")
    if bool((counts == width).all()):
        mask = torch.ones(len(rows), width, dtype=torch.bool)
        return PointSets(torch.from_numpy(every).view(len(rows), width, 2), mask)
    mask = torch.arange(width) < counts[:, None]
    points = torch.zeros(len(rows), width, 2)
    points[mask] = torch.from_numpy(every)
    return PointSets(points, mask)


def _as_rows(points: ArrayLike | Tensor, number: int) -> NDArray[np.float32]:
    """One point set (N, 2); an empty list is an empty set."""
    rows = np.asarray(points.detach().numpy() if isinstance(points, Tensor) else points, np.float32)
    if rows.size == 0:
        return np.zeros((0, 2), np.float32)
    if rows.ndim != 2 or rows.shape[1] != 2:
        raise ShapeError(f"point set {number} must have shape (N, 2), x and y in px, got {tuple(rows.shape)}.")
    return rows


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
