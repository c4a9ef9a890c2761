"""Rigid poses without a starting guess: a search over all rotations, and the refinement of many poses at once."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from torch import Tensor

from ursnav_torch.geometry import Array

#: Rotations tried, about 12 degrees apart.
_ROTATIONS = 4608


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """B rigid poses ``p_kidney = R (p_em - center) + t``.

    Attributes:
        R: (B, 3, 3), t: (B, 3) mm, kidney frame; center: (3,) mm, EM frame.
    """

    R: Tensor
    t: Tensor
    center: Tensor

    def apply(self, points_em: Tensor) -> Tensor:
        """(B, N, 3) points (N, 3) of the EM frame in the kidney frame."""
        return (points_em - self.center) @ self.R.mT + self.t[:, None]

    def pick(self, rows: Tensor) -> "Poses":
        """The poses in some rows (K,)."""
        return Poses(self.R[rows], self.t[rows], self.center)

    def about(self, center: Tensor) -> "Poses":
        """The same poses written about another center (3,)."""
        return Poses(self.R, self.t + self.R @ (center - self.center), center)

    def moved(self, step: Tensor) -> "Poses":
        """Turned by rotation vectors step[:, :3] (rad, kidney axes, about t) and shifted by step[:, 3:] (mm)."""
        turn = Rotation.from_rotvec(step[:, :3].double().numpy()).as_matrix()
        return Poses(torch.from_numpy(turn).to(self.R) @ self.R, self.t + step[:, 3:], self.center)


@dataclass(slots=True, eq=False)
class Misfit:
    """How badly B poses explain N samples, and the Gauss-Newton step that explains them better.

    Attributes:
        weights: (B, N) of the samples.
        cost: (B, N) cost of each sample, unweighted.
        normal: (B, 6, 6) and gradient: (B, 6), weighted sums, in the order of `Poses.moved`.
    """

    weights: Tensor
    cost: Tensor
    normal: Tensor
    gradient: Tensor

    @classmethod
    def zero(cls, weights: Tensor) -> "Misfit":
        """Nothing added yet."""
        B = len(weights)
        return cls(weights, torch.zeros_like(weights), weights.new_zeros(B, 6, 6), weights.new_zeros(B, 6))

    def add_distances(self, arm: Tensor, distance: Tensor, normal: Tensor, sigma_mm: float, soft_mm: float) -> None:
        """Add Huber's cost of distances (B, N) with gradients ``normal`` (B, N, 3) at points ``arm`` (B, N, 3) from t.

        Quadratic with ``sigma_mm`` up to ``soft_mm``, linear beyond; negative distances cost like positive ones.
        """
        size = distance.abs()
        self.cost += torch.where(size < soft_mm, size**2 / 2, soft_mm * (size - soft_mm / 2)) / sigma_mm**2
        weight = self.weights / sigma_mm**2 * (soft_mm / size.clamp(min=soft_mm))
        J = torch.cat([torch.linalg.cross(arm, normal), normal], -1)
        weighted = weight[..., None] * J
        self.normal += weighted.mT @ J
        self.gradient += (weighted * distance[..., None]).sum(1)

    def add_directions(self, direction: Tensor, wanted: Tensor, sigma: float, keep: float) -> None:
        """Add the squared difference of unit vectors (B, N, 3), of which only the best ``keep`` part pulls."""
        difference = (direction - wanted).square().sum(-1)
        limit = torch.quantile(difference, keep, dim=1, keepdim=True)
        self.cost += difference.minimum(limit) / 2 / sigma**2
        weight = (self.weights * (difference <= limit) / sigma**2)[..., None]
        eye = torch.eye(3).to(weight) * weight.sum(1, keepdim=True)
        self.normal[:, :3, :3] += eye - (weight * direction).mT @ direction
        self.gradient[:, :3] += (weight * torch.linalg.cross(direction, direction - wanted)).sum(1)


#: What poses cost on the samples that the function was made for; the weights are (B, N).
MisfitOf = Callable[[Poses, Tensor], Misfit]


def even_rotations(count: int) -> Array:
    """(count, 3, 3) rotations spread evenly over all of them: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    s = np.arange(count) + 0.5
    r, rest = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), rest * np.sin(b), rest * np.cos(b)], axis=-1)
    return Rotation.from_quat(quaternions).as_matrix()


def search_rotations(cost: Callable[[Tensor], Tensor], points_em: Tensor, anchors_mm: Tensor, keep: int) -> Poses:
    """The best poses among all rotations and places.

    For each rotation one point of the set, its most central one, is put on each of the anchors.

    Args:
        cost: cost (A, N) of points (A, N, 3), kidney frame.
        points_em: (N, 3) points, EM frame.
        anchors_mm: (A, 3) places near one of which the central point must lie, kidney frame.
        keep: number of rotations to return, each with its best place.
    """
    central = points_em[(points_em - points_em.median(dim=0).values).norm(dim=-1).argmin()]
    rotations = torch.from_numpy(even_rotations(_ROTATIONS)).to(points_em)
    best, place = torch.zeros(_ROTATIONS), torch.zeros(_ROTATIONS, dtype=torch.long)
    for i, R in enumerate(rotations):
        best[i], place[i] = cost(((points_em - central) @ R.T)[None] + anchors_mm[:, None]).mean(-1).min(0)
    rows = best.argsort()[:keep]
    return Poses(rotations[rows], anchors_mm[place[rows]], central).about(points_em.mean(0))


def refine(poses: Poses, misfit: MisfitOf, weights: Tensor, steps: int) -> tuple[Poses, Misfit]:
    """Refine B poses at once by Levenberg's and Marquardt's method; weights are (B, N) or (N,)."""
    weights = weights.expand(len(poses.t), weights.shape[-1])
    now = misfit(poses, weights)
    damping = torch.full_like(poses.t[:, :1], 1e-3)
    for _ in range(steps):
        ridge = torch.diag_embed(now.normal.diagonal(dim1=-2, dim2=-1) * damping + 1e-6)
        step = torch.linalg.solve(now.normal + ridge, -now.gradient)
        trial = poses.moved(step * (5.0 / step[:, 3:].norm(dim=-1, keepdim=True).clamp(min=5.0)))
        then = misfit(trial, weights)
        better = (weights * (then.cost - now.cost)).sum(-1) < 0
        poses = Poses(_where(better, trial.R, poses.R), _where(better, trial.t, poses.t), poses.center)
        now = Misfit(
            weights,
            _where(better, then.cost, now.cost),
            _where(better, then.normal, now.normal),
            _where(better, then.gradient, now.gradient),
        )
        damping = torch.where(better[:, None], damping / 5, damping * 8).clamp(1e-6, 1e6)
    return poses, now


def distinct(poses: Poses, cost: Tensor, points_em: Tensor, apart_mm: float) -> Tensor:
    """Rows of the poses, best cost (B,) first, that place points (N, 3) ``apart_mm`` RMS away from every better one."""
    moved = poses.apply(points_em)
    rows: list[int] = []
    for i in cost.argsort().tolist():
        if not rows or (moved[rows] - moved[i]).square().sum(-1).mean(-1).sqrt().min() > apart_mm:
            rows.append(i)
    return torch.tensor(rows)


def as_tensor(values: ArrayLike) -> Tensor:
    """Numbers (...) as float32 (...), the precision of the search."""
    return torch.tensor(np.asarray(values), dtype=torch.float32)


def _where(mask: Tensor, a: Tensor, b: Tensor) -> Tensor:
    return torch.where(mask.reshape(-1, *[1] * (a.ndim - 1)), a, b)
