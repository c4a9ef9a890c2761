"""Features as the default's, with points on the dark rims of the wall in place of Canny's edges.

A fold or a neck shows as a dark line with a flank on either side. Canny finds both flanks; the line is found once, and
again in the next picture.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ursnav_torch.features.default import DefaultExtractor, DefaultSettings
from ursnav_torch.features.flatten import masked_blur


@dataclass(frozen=True, slots=True)
class RimSettings(DefaultSettings):
    """As `DefaultSettings`, with other points: `contour_blur` smooths before the Hessian, `low` and `high` are
    percentiles of its eigenvalue on the ridges. The smoothing was chosen by shapes alone on phantoms, see the
    notes of `benchmarks.finalists`, which compares these points with the default's.
    """

    contour_blur: float = 0.0096


class RimExtractor(DefaultExtractor):
    """See `DefaultExtractor`; edge points lie on dark rims and run along them."""

    def _ridges(self, relief: Tensor) -> tuple[Tensor, Tensor]:
        return dark_rims(relief, self._small_mask, self.settings.contour_blur * self._unit)


def dark_rims(relief: Tensor, mask: Tensor, sigma_px: float) -> tuple[Tensor, Tensor]:
    """Dark lines of a relief: ridges of the larger eigenvalue of its Hessian, thinned across the line.

    Ridge detection (Lindeberg, Edge detection and ridge detection with automatic scale selection, IJCV 1998) at one
    scale: the eigenvector of the larger eigenvalue points across a dark line, and the eigenvalue, the curvature across,
    is the largest there. `benchmarks.finalists` compared these points with Canny's.

    Args:
        relief: (h, w).
        mask: (h, w) 1.0 where the relief is to be trusted; nothing else is smoothed in.
        sigma_px: of the Gaussian before the Hessian, in px of the relief; as wide as half the lines looked for.

    Returns:
        Strength (h, w), the curvature in relief a square px, 0 off the rims and outside the mask; and the unit
        direction across (2, h, w), x and y.
    """
    gy, gx = torch.gradient(masked_blur(relief, mask, sigma_px))
    gyy, gxy = torch.gradient(gy)
    gxx = torch.gradient(gx, dim=1)[0]
    half = torch.hypot((gxx - gyy) / 2, gxy)
    curvature = ((gxx + gyy) / 2 + half).clamp_min(0) * (mask > 0)
    angle = torch.atan2(2 * gxy, gxx - gyy) / 2
    across = torch.stack([angle.cos(), angle.sin()])
    thin = (curvature >= _beside(curvature, across)) & (curvature > _beside(curvature, -across))
    return torch.where(thin, curvature, 0.0), across


def _beside(image: Tensor, step: Tensor) -> Tensor:
    """An image (h, w) a step (2, h, w), x and y in px, away from each pixel."""
    h, w = image.shape
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    unit = [(2 * (at + by) + 1) / size - 1 for at, by, size in ((x, step[0], w), (y, step[1], h))]
    grid = torch.stack(unit, -1)[None]
    return torch.nn.functional.grid_sample(image[None, None], grid, align_corners=False, padding_mode="border")[0, 0]
