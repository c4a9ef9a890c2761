"""Edges of a relief: Canny's thinned gradient, thresholds that follow the picture, hysteresis by components."""

import cv2
import numpy as np
import torch
from kornia.filters import canny
from numpy.typing import NDArray
from skimage.filters import apply_hysteresis_threshold
from skimage.measure import label
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
    edges = apply_hysteresis_threshold(ridge.numpy(), low, high)
    components = label(edges, connectivity=2)
    long_enough = np.bincount(components.ravel()) >= min_length_px
    long_enough[0] = False
    return np.asarray(long_enough[components])


def edge_points(edges: NDArray[np.bool_], slope: Tensor, ridge: Tensor, scale: tuple[float, float]) -> EdgePoints:
    """The edge pixels (H, W) as points in the full picture, which is ``scale`` = (sx, sy) times as large.

    Args:
        edges: (H, W) edge pixels.
        slope: (2, H, W) gradient; the edge runs across it.
        ridge: (H, W) strength; weights are its share of the 90th percentile, at most 1.
        scale: px of the full picture a px here.
    """
    y, x = (torch.from_numpy(v) for v in np.nonzero(edges))
    gx, gy = slope[0, y, x], slope[1, y, x]
    strength = ridge[y, x]
    top = torch.quantile(strength, 0.9) if len(strength) else torch.ones(())
    points = torch.stack([(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5], 1).float()
    direction = torch.remainder(torch.atan2(gy, gx) + torch.pi / 2, torch.pi)
    return EdgePoints(points, direction.float(), (strength / top.clamp_min(1e-9)).clamp(max=1).float())
