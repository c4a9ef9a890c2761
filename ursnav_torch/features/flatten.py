"""Pictures made comparable: stripes out, then the logarithm divided by its own surroundings.

What is left is the wall's relief, whatever the exposure, the light's place and the lens's vignette were.
"""

import torch
from kornia.filters import gaussian_blur2d
from torch import Tensor

#: A sinusoid over the rows is a stripe pattern when its spectral line stands this far above the median line.
STRIPE_STRENGTH = 12.0
#: Slowest stripes looked for, cycles a row; slower changes are anatomy.
STRIPE_MIN_FREQUENCY = 0.08


def blur(x: Tensor, sigma_px: float) -> Tensor:
    """Gaussian blur of (..., H, W) with zeros beyond the border."""
    size = 2 * max(1, round(3 * sigma_px)) + 1
    flat = x.reshape(1, -1, *x.shape[-2:])
    return gaussian_blur2d(flat, (size, size), (sigma_px, sigma_px), border_type="constant").reshape(x.shape)


def masked_blur(x: Tensor, mask: Tensor, sigma_px: float) -> Tensor:
    """Gaussian mean of (..., H, W) over the pixels where ``mask`` (H, W) is 1 (normalized convolution)."""
    both = blur(torch.stack([x * mask, mask.expand_as(x)]), sigma_px)
    return both[0] / both[1].clamp_min(1e-3)


def remove_stripes(x: Tensor, mask: Tensor, most: int = 3) -> Tensor:
    """Subtract horizontal interference stripes (thesis §3.5.1) from a log image (H, W).

    Each stripe pattern is one sinusoid over the rows, fitted and subtracted; a zeroed band of the spectrum would
    take structure of the wall with it. A picture without a line of `STRIPE_STRENGTH` is returned as it is.
    """
    for _ in range(most):
        count = mask.sum(1)
        rows = (x * mask).sum(1) / count.clamp_min(1)
        kernel = torch.exp(-0.5 * (torch.arange(-9.0, 10.0) / 3) ** 2)
        high = rows - _smooth(rows, count, kernel)
        line = torch.fft.rfft(high * count.sqrt(), n=2048).abs()
        frequency = torch.arange(len(line)) / 2048
        band = frequency > STRIPE_MIN_FREQUENCY
        peak = int(torch.where(band, line, 0).argmax())
        if line[peak] < STRIPE_STRENGTH * line[band].median():
            break
        phase = 2 * torch.pi * frequency[peak] * torch.arange(len(rows))
        basis = torch.stack([phase.cos(), phase.sin()], 1)
        seen = torch.stack([b - _smooth(b, count, kernel) for b in basis.T], 1) * count.sqrt()[:, None]
        amplitude = _least_squares(seen, high * count.sqrt())
        x = x - (basis * amplitude).sum(1)[:, None]
    return x


def flatten(log_image: Tensor, mask: Tensor, sigma_px: float, floor: float = 0.02, most: float = 3.0) -> Tensor:
    """Relief (H, W): the log image less its surroundings, in units of its own local contrast, within +-``most``.

    Args:
        log_image: (H, W) logarithm of intensity.
        mask: (H, W) 1.0 inside the picture.
        sigma_px: reach of the surroundings.
        floor: contrast (in log units) below which nothing is amplified: noise, not relief.
        most: highlights and vessels are clamped here.
    """
    detail = (log_image - masked_blur(log_image, mask, sigma_px)) * mask
    contrast = (masked_blur(detail * detail, mask, sigma_px) + floor**2).sqrt()
    return (detail / contrast).clamp(-most, most) * mask


def _least_squares(a: Tensor, b: Tensor) -> Tensor:
    """The x (2,) that brings a (N, 2) @ x nearest to b (N,); LAPACK's differs in the last bit from call to call."""
    (cc, ss), cs = (a * a).sum(0), a.prod(1).sum()
    cc, ss = cc + 1e-6 * (cc + ss), ss + 1e-6 * (cc + ss)
    cb, sb = (a * b[:, None]).sum(0)
    return torch.stack([ss * cb - cs * sb, cc * sb - cs * cb]) / (cc * ss - cs * cs)


def local_contrast(log_image: Tensor, mask: Tensor, sigma_px: float) -> float:
    """log10 of the median, over the picture, of the local standard deviation of a log image (H, W)."""
    detail = (log_image - masked_blur(log_image, mask, sigma_px)) * mask
    spread = masked_blur(detail * detail, mask, sigma_px)[mask > 0].median().clamp_min(1e-12)
    return float(spread.log10()) / 2


def _smooth(rows: Tensor, weight: Tensor, kernel: Tensor) -> Tensor:
    """Weighted moving mean of (H,) with an odd kernel."""
    both = torch.stack([rows * weight, weight])[:, None]
    total = torch.nn.functional.conv1d(both, kernel[None, None], padding=len(kernel) // 2)[:, 0]
    return total[0] / total[1].clamp_min(1e-6)
