"""Least-squares rigid and similarity transforms of point pairs, batched."""

import torch
from torch import Tensor

from ursnav_torch.errors import ShapeError


def fit_rigid(
    source: Tensor, target: Tensor, weights: Tensor | None = None, *, with_scale: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """Rotations, translations and scales that take source points to target points: ``target = scale * R @ source + t``.

    Arun, Huang, Blostein, PAMI 1987 (thesis section 4.4), with Umeyama's (PAMI 1991) sign that excludes reflections
    and his scale. Nothing is checked beyond shapes: with fewer than three points, or points on a line, the answer
    is one of many.

    Args:
        source: (..., N, 3) points.
        target: (..., N, 3) their partners.
        weights: (..., N) nonnegative weights of the pairs, all equal by default.
        with_scale: whether to fit a scale too; otherwise it is 1.

    Returns:
        R (..., 3, 3), t (..., 3) and scale (...), in the dtype of ``source``.

    Raises:
        ShapeError: the shapes do not fit.
    """
    if source.shape != target.shape or source.ndim < 2 or source.shape[-1] != 3:
        raise ShapeError(f"Expected two sets (..., N, 3), got {tuple(source.shape)} and {tuple(target.shape)}.")
    w = torch.ones_like(source[..., 0]) if weights is None else weights.to(source).expand(source.shape[:-1])
    w = (w / w.sum(-1, keepdim=True))[..., None]
    source_mean, target_mean = (w * source).sum(-2), (w * target).sum(-2)
    a, b = source - source_mean[..., None, :], target - target_mean[..., None, :]
    U, S, Vh = torch.linalg.svd((w * b).mT @ a)
    sign = torch.ones_like(S)
    sign[..., 2] = torch.where(torch.linalg.det(U @ Vh) < 0, -1.0, 1.0)
    R = (U * sign[..., None, :]) @ Vh
    scale = (S * sign).sum(-1) / (w * a * a).sum((-2, -1)) if with_scale else torch.ones_like(S[..., 0])
    return R, target_mean - scale[..., None] * (R @ source_mean[..., None])[..., 0], scale
