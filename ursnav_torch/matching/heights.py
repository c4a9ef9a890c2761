"""Height functions of closed outlines: how far every other point lies beside a point's tangent, and on which side.

Wang, Bai, You, Liu, Latecki: Shape matching and classification using height functions, Pattern Recognition Letters
2012. Beside shape contexts they tell outlines apart that bend or stretch; they need a closed outline in order, which a
silhouette has and an endoscope's edges do not.
"""

import torch
from torch import Tensor

from ursnav_torch.errors import ShapeError

#: Neighboring heights that become one number, so that a limb may be a little longer or shorter.
_TOGETHER = 5


def contour_heights(points: Tensor, tangents: Tensor) -> Tensor:
    """Features whose Euclidean distances are the root of the weighted mean square of differing heights.

    Heights are taken in the order of the points from each point on, five at a time, in units of the outline's largest
    at that many places further on. What is near along the outline counts more, one over its distance: bending adds up.

    Args:
        points: (V, P, 2) px, closed outlines in order, P >= 6.
        tangents: (V, P) direction of the outline in radians, x towards y.

    Returns:
        (V, P, (P - 1) // 5) float32.
    """
    if points.ndim != 3 or points.shape[2] != 2 or tangents.shape != points.shape[:2] or points.shape[1] <= _TOGETHER:
        raise ShapeError(
            f"Expected points (V, P, 2) with P > {_TOGETHER} and tangents (V, P), got {tuple(points.shape)} and "
            f"{tuple(tangents.shape)}."
        )
    count = points.shape[1]
    parts = (count - 1) // _TOGETHER
    first = (count - 1 - parts * _TOGETHER) // 2 + 1
    here = torch.arange(count)
    further = (here[:, None] + torch.arange(first, first + parts * _TOGETHER)) % count
    way = points[:, further] - points[:, :, None]
    heights = tangents.cos()[..., None] * way[..., 1] - tangents.sin()[..., None] * way[..., 0]
    heights = heights.reshape(*heights.shape[:2], parts, _TOGETHER).mean(3)
    heights = heights / heights.abs().amax(1, keepdim=True).clamp_min(1e-9)
    at = torch.arange(parts) + 0.5
    weights = 1 / torch.minimum(at, parts - at)
    return (heights * (weights / weights.sum()).sqrt()).float()
