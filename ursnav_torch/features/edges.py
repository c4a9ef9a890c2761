"""Edges of a relief: Canny's thinned gradient, thresholds that follow the picture, hysteresis by components."""

import cv2
import numpy as np
import torch
from kornia.filters import canny
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.features.base import EdgePoints


def thin_gradient(image: Tensor, sigma_px: float) -> Tensor:
    """Gradient magnitude (H, W) of an image (H, W), zero off the ridges (Canny 1986; kornia, without hysteresis)."""
    size = 2 * max(1, round(3 * sigma_px)) + 1
    magnitude, _ = canny(image[None, None], 1e-6, 2e-6, (size, size), (sigma_px, sigma_px), hysteresis=False)
    return magnitude[0, 0]


def gradient(image: Tensor) -> Tensor:
    """Sobel gradient (2, H, W), d/dx and d/dy, of an image (H, W)."""
    plane = image.numpy()
    slopes = [cv2.Sobel(plane, -1, *way, scale=1 / 8, borderType=cv2.BORDER_REPLICATE) for way in ((1, 0), (0, 1))]
    return torch.from_numpy(np.stack(slopes))


def link(ridge: Tensor, low: float, high: float, min_length_px: int) -> NDArray[np.bool_]:
    """Edges (H, W): ridges above ``low`` joined to one above ``high``, in groups of ``min_length_px`` at least."""
    strength = ridge.numpy()
    count, parts = cv2.connectedComponents((strength > low).view(np.uint8), connectivity=4)
    kept = np.zeros(count, bool)
    kept[parts[strength > high]] = True
    kept[0] = False
    _, groups, boxes, _ = cv2.connectedComponentsWithStats(kept[parts].view(np.uint8), connectivity=8)
    long_enough = boxes[:, cv2.CC_STAT_AREA] >= min_length_px
    long_enough[0] = False
    return np.asarray(long_enough[groups])


def edge_points(edges: NDArray[np.bool_], slope: Tensor, ridge: Tensor, scale: tuple[float, float]) -> EdgePoints:
    """The edge pixels (H, W) as points in the full picture, which is ``scale`` = (sx, sy) times as large.

    Args:
        edges: (H, W) edge pixels.
        slope: (2, H, W) gradient; the edge runs across it.
        ridge: (H, W) strength; weights are its share of the 90th percentile, at most 1.
        scale: px of the full picture a px here.
    """
    y, x = np.nonzero(edges)
    gx, gy = slope.numpy()[:, y, x]
    strength = ridge.numpy()[y, x]
    top = max(float(np.quantile(strength, 0.9)), 1e-9) if len(strength) else 1.0
    points = np.stack([(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5], 1)
    direction = np.remainder(np.arctan2(gy, gx) + np.pi / 2, np.pi)
    found = (points, direction, np.minimum(strength / top, 1))
    return EdgePoints(*(torch.from_numpy(part.astype(np.float32)) for part in found))
