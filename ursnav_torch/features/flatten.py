"""Pictures made comparable: stripes out, then the logarithm less its own surroundings.

What is left is the wall's relief, whatever the exposure, the light's place and the lens's vignette were.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from kornia.filters import get_gaussian_kernel1d
from torch import Tensor

#: A sinusoid over the rows is a stripe pattern when its spectral line stands this far above the median line.
STRIPE_STRENGTH = 12.0
#: Slowest stripes looked for, cycles a row; slower changes are anatomy.
STRIPE_MIN_FREQUENCY = 0.08
#: Values of the transform that finds them, and rows over which slower changes are told.
_TRANSFORMED, _SMOOTH_ROWS = 2048, 3.0
#: Slopes are held back a little where surroundings are too thin to tell them.
_FLAT = 1e-3


def blur(x: Tensor, sigma_px: float) -> Tensor:
    """Gaussian blur of (..., H, W) with zeros beyond the border.

    Two products with a band matrix: on pictures as small as the working ones they are faster than convolutions.
    """
    height, width = (_band(n, sigma_px, x.dtype) for n in x.shape[-2:])
    return height @ x @ width.T


@lru_cache(maxsize=64)
def _band(length: int, sigma_px: float, dtype: torch.dtype) -> Tensor:
    """The matrix (n, n) that blurs a column of n pixels; its rows are kornia's kernel, shifted."""
    reach = max(1, round(3 * sigma_px))
    kernel = get_gaussian_kernel1d(2 * reach + 1, sigma_px, dtype=torch.float64)[0]
    wide = torch.zeros(length, length + 2 * reach, dtype=torch.float64)
    for row in range(length):
        wide[row, row : row + 2 * reach + 1] = kernel
    return wide[:, reach : reach + length].to(dtype).contiguous()


def masked_blur(x: Tensor, mask: Tensor, sigma_px: float) -> Tensor:
    """Gaussian mean of (..., H, W) over the pixels where ``mask`` (H, W) is 1 (normalized convolution)."""
    return MaskedBlur(mask, sigma_px)(x)


class MaskedBlur:
    """`masked_blur` of many images under one mask, whose own blur is made once.

    Args:
        mask: (H, W) 1.0 inside the picture.
        sigma_px: of the Gaussian.
    """

    def __init__(self, mask: Tensor, sigma_px: float) -> None:
        self.sigma_px, self._mask = sigma_px, mask
        self._share = blur(mask, sigma_px).clamp_min(1e-3)

    def __call__(self, x: Tensor) -> Tensor:
        """The Gaussian means (..., H, W) of images (..., H, W)."""
        return blur(x * self._mask, self.sigma_px) / self._share


def remove_stripes(x: Tensor, mask: Tensor, most: int = 3) -> Tensor:
    """Subtract horizontal interference stripes (thesis §3.5.1) from a log image (H, W).

    Each stripe pattern is one sinusoid over the rows, fitted and subtracted; a zeroed band of the spectrum would
    take structure of the wall with it. A picture without a line of `STRIPE_STRENGTH` is returned as it is.
    """
    count, frequency = mask.sum(1), _frequencies()
    band, root = frequency > STRIPE_MIN_FREQUENCY, count.sqrt()
    for _ in range(most):
        rows = torch.linalg.vecdot(x, mask) / count.clamp_min(1)
        high = rows - _smooth(rows[:, None], count)[:, 0]
        line = torch.fft.rfft(high * root, n=_TRANSFORMED).abs()
        peak = int(torch.where(band, line, 0).argmax())
        if line[peak] < STRIPE_STRENGTH * line[band].median():
            break
        phase = 2 * torch.pi * frequency[peak] * torch.arange(len(rows))
        basis = torch.stack([phase.cos(), phase.sin()], 1)
        seen = (basis - _smooth(basis, count)) * root[:, None]
        amplitude = _least_squares(seen, high * root)
        x = x - (basis * amplitude).sum(1)[:, None]
    return x


@lru_cache(maxsize=1)
def _frequencies() -> Tensor:
    """Of a transform's lines, cycles a row."""
    return torch.arange(_TRANSFORMED // 2 + 1) / _TRANSFORMED


class LocalPlane:
    """The plane through an image's surroundings of each pixel, by least squares over the pixels inside.

    A mean would do in the middle of a picture. At its rim all surroundings lie on one side, and a mean takes every
    slope of the light, from its beam or the lens's vignette, for relief. This is normalized convolution of first
    order (Knutsson and Westin, Normalized and differential convolution, CVPR 1993).

    Args:
        mask: (H, W) 1.0 inside the picture.
        sigma_px: reach of the surroundings, the width of their Gaussian weight.
        dtype: that it is made in; single precision is right to 1e-5 and half the time.

    Attributes:
        sigma_px: as given.
        columns: (3, H, W) what the image is multiplied by before it is blurred: inside, and x and y there.
        weights: (3, H, W) how much each blurred product counts.
    """

    def __init__(self, mask: Tensor, sigma_px: float, dtype: torch.dtype = torch.float64) -> None:
        self.sigma_px, self._mask = sigma_px, mask
        self._blur = MaskedBlur(mask, sigma_px)
        y, x = ((torch.arange(n, dtype=dtype) - (n - 1) / 2) / sigma_px for n in mask.shape)
        inside = mask.to(dtype)
        x, y = x[None] * torch.ones_like(inside), y[:, None] * torch.ones_like(inside)
        columns = torch.stack([inside, inside * x, inside * y])
        count, *sums = blur(torch.cat([columns, inside * torch.stack([x * x, x * y, y * y])]), sigma_px)
        count = count.clamp_min(1e-6)
        at_x, at_y, xx, xy, yy = (s / count for s in sums)
        mean_x, mean_y = at_x - x, at_y - y  # moments about each pixel, where the numbers are small
        xx, yy = xx - 2 * x * at_x + x * x + _FLAT, yy - 2 * y * at_y + y * y + _FLAT
        xy = xy - x * at_y - y * at_x + x * y
        own = xx * yy - xy * xy  # Cramer's rule for the plane's height at the pixel
        to_x, to_y = xy * mean_y - mean_x * yy, mean_x * xy - xx * mean_y
        share = torch.where(inside > 0, inside / (count * (own + mean_x * to_x + mean_y * to_y)), 0)
        self.columns = columns.float()
        self.weights = (torch.stack([own - to_x * x - to_y * y, to_x, to_y]) * share).float()

    def __call__(self, image: Tensor) -> Tensor:
        """The planes' heights (H, W) at the pixels of an image (H, W); 0 outside."""
        return (blur(self.columns * image, self.sigma_px) * self.weights).sum(0)

    def detail(self, image: Tensor) -> Tensor:
        """An image (H, W) less its surroundings; 0 outside."""
        return (image - self(image)) * self._mask

    def variance(self, detail: Tensor) -> Tensor:
        """The local variance (H, W) of a detail (H, W); 0 outside."""
        return self._blur(detail * detail)


def flatten(log_image: Tensor, mask: Tensor, around: LocalPlane, floor: float = 0.02, most: float = 3.0) -> Tensor:
    """Relief (H, W): the log image less its surroundings, in units of its own local contrast, within +-``most``.

    Args:
        log_image: (H, W) logarithm of intensity.
        mask: (H, W) 1.0 inside the picture.
        around: the surroundings.
        floor: contrast (in log units) below which nothing is amplified: noise, not relief.
        most: highlights and vessels are clamped here.
    """
    detail = around.detail(log_image)
    return flat_of(detail, around.variance(detail), mask, floor, most)


def flat_of(detail: Tensor, variance: Tensor, mask: Tensor, floor: float = 0.02, most: float = 3.0) -> Tensor:
    """`flatten` (H, W) of what `LocalPlane.detail` gives, and its local variance."""
    return (detail / (variance + floor**2).sqrt()).clamp(-most, most) * mask


def _least_squares(a: Tensor, b: Tensor) -> Tensor:
    """The x (2,) that brings a (N, 2) @ x nearest to b (N,); LAPACK's differs in the last bit from call to call."""
    (cc, ss), cs = (a * a).sum(0), a.prod(1).sum()
    cc, ss = cc + 1e-6 * (cc + ss), ss + 1e-6 * (cc + ss)
    cb, sb = (a * b[:, None]).sum(0)
    return torch.stack([ss * cb - cs * sb, cc * sb - cs * cb]) / (cc * ss - cs * cs)


def local_contrast(variance: Tensor, mask: Tensor) -> float:
    """log10 of the median, over the picture, of the local standard deviation, from `LocalPlane.variance` (H, W)."""
    inside = variance.numpy()[mask.numpy() > 0]
    middle = (len(inside) - 1) // 2
    return math.log10(max(float(np.partition(inside, middle)[middle]), 1e-12)) / 2


def _smooth(rows: Tensor, weight: Tensor) -> Tensor:
    """Weighted moving means (H, C) of rows (H, C)."""
    band, weight = _band(len(rows), _SMOOTH_ROWS, rows.dtype), weight[:, None]
    return (band @ (rows * weight)) / (band @ weight).clamp_min(1e-6)
