"""Edges of a relief: Canny's thinned gradient, thresholds that follow the picture, hysteresis by components."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.features.base import EdgePoints

Floats = NDArray[np.float32]

#: The square of the magnitude that kornia gives a pixel without any gradient.
_NO_GRADIENT = 1e-6
#: Gradients whose sides are as 1 to this or flatter run along an axis: a line at half of 45 degrees.
_AXIS = float(np.tan(np.pi / 8))


def thin_gradient(image: Tensor, sigma_px: float) -> Tensor:
    """Gradient magnitude (H, W) of an image (H, W), zero off the ridges (Canny 1986).

    What `kornia.filters.canny` gives without hysteresis, up to rounding, in a tenth of its time.
    """
    size = 2 * max(1, round(3 * sigma_px)) + 1
    smooth = cv2.GaussianBlur(image.numpy(), (size, size), sigma_px, borderType=cv2.BORDER_REFLECT_101)
    x, y = (cv2.Sobel(smooth, -1, *way, borderType=cv2.BORDER_REPLICATE) for way in ((1, 0), (0, 1)))
    strength = np.sqrt(x * x + y * y + np.float32(_NO_GRADIENT))
    return torch.from_numpy(np.where(_ridges(strength, x, y), strength, np.float32(0)))


def _ridges(strength: Floats, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Where gradients (H, W) are stronger than their neighbors ahead and behind, in the nearest of four directions.

    Of two alike along an axis the left or upper one is the ridge; diagonally neither is.
    """
    h, w = strength.shape
    framed = np.pad(strength, 1, constant_values=np.float32(_NO_GRADIENT**0.5))

    def beside(down: int, right: int) -> Floats:
        return framed[1 + down : 1 + down + h, 1 + right : 1 + right + w]

    across, along = np.abs(x), np.abs(y)
    level = (strength > beside(0, -1)) & (strength >= beside(0, 1))
    upright = (strength > beside(-1, 0)) & (strength >= beside(1, 0))
    falling = (strength > beside(-1, -1)) & (strength > beside(1, 1))
    rising = (strength > beside(-1, 1)) & (strength > beside(1, -1))
    diagonal = np.where((x > 0) == (y > 0), falling, rising)
    ridge = np.where(along <= _AXIS * across, level, np.where(across <= _AXIS * along, upright, diagonal))
    return np.asarray(ridge & (strength > framed[0, 0]))


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
