"""Edge directions from points alone, for point sets that come without."""

import math

import torch
from torch import Tensor

from ursnav_torch.threads import map_chunks

_PAIRS_A_CHUNK = 400_000


def estimate_directions(points: Tensor, mask: Tensor, neighbors: int = 4) -> Tensor:
    """Direction of the line that fits a point and its nearest neighbors best.

    Args:
        points: (B, P, 2) px.
        mask: (B, P) bool, true where there is a point.
        neighbors: points beside the point itself, near ones counting more.

    Returns:
        (B, P) radians in (-pi/2, pi/2], x towards y, modulo pi; zero where there is no point or only one place.
    """
    out = torch.zeros(mask.shape)
    if points.shape[1] < 2:
        return out
    pairs = points.shape[1] ** 2

    def work(part: slice) -> None:
        out[part] = _fitted(points[part].float(), mask[part], min(neighbors, points.shape[1] - 1) + 1)

    map_chunks(work, len(points), max(1, _PAIRS_A_CHUNK // pairs), float(30 * len(points) * pairs))
    return out


def _fitted(points: Tensor, mask: Tensor, count: int) -> Tensor:
    difference = points[:, None] - points[:, :, None]
    squared = difference.square().sum(3).masked_fill_(~mask[:, None, :], math.inf)
    near, index = squared.topk(count, 2, largest=False)
    index = torch.where(near < math.inf, index, torch.arange(points.shape[1])[None, :, None])
    local = difference.gather(2, index[..., None].expand(*index.shape, 2))
    weight = 1 / (1 + torch.where(near < math.inf, near, 0.0).sqrt())[..., None]
    x, y = (local * weight).unbind(3)
    xx, yy, xy = (x * x).sum(2), (y * y).sum(2), (x * y).sum(2)
    return 0.5 * torch.atan2(2 * xy, xx - yy) * mask
