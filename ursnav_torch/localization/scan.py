"""Scanning the whole VID at every roll: polar maps correlated over their shift by FFT."""

from dataclasses import dataclass

import torch
from torch import Tensor

#: Frequencies around the axis that are kept; the maps hold nothing finer than 360 / 24 = 15 degrees of detail.
FREQUENCIES = 24


@dataclass(frozen=True, slots=True)
class ScanResult:
    """How well each view's maps fit a query's, at the roll that suits it best.

    Attributes:
        score: (V,) weighted sum of the channels' correlations at that roll; 1 is a perfect fit.
        roll: (V,) radians in [-pi, pi): ``T_kidney_query = T_kidney_view @ Rz(roll)``.
    """

    score: Tensor
    roll: Tensor


class RollScan:
    """The spectra of all views' polar maps, ready to be correlated with a query's.

    Args:
        maps: (V, C, R, A) polar maps, each channel group of unit length.
        weight: (C,) weight of each channel's correlation; they are scaled to sum to 1 over channel groups.

    Memory: 8 V C R F bytes for F = 24 frequencies (42 MB for 2,160 views of 5 x 20 rings).
    """

    def __init__(self, maps: Tensor, weight: Tensor) -> None:
        self._sectors = maps.shape[-1]
        self._weight = weight
        kept = min(FREQUENCIES, self._sectors // 2)
        spectrum = torch.fft.rfft(maps.float())[..., :kept].flatten(1, 2).permute(2, 0, 1)
        self._spectrum = torch.view_as_real(spectrum.contiguous()).flatten(2)

    def __len__(self) -> int:
        return self._spectrum.shape[1]

    def scan(self, maps: Tensor) -> ScanResult:
        """Compare a query's maps (C, R, A) with every view's."""
        kept = self._spectrum.shape[0]
        query = torch.fft.rfft(maps.float() * self._weight[:, None, None])[..., :kept].flatten(0, 1).T
        columns = torch.stack([torch.view_as_real(query), torch.view_as_real(-1j * query)], -1).flatten(1, 2)
        product = torch.bmm(self._spectrum, columns)
        over_shift = torch.fft.irfft(torch.complex(product[..., 0], -product[..., 1]).T, n=self._sectors)
        score, shift = over_shift.max(1)
        around = torch.stack([over_shift.gather(1, ((shift + d) % self._sectors)[:, None])[:, 0] for d in (-1, 1)])
        bend = (around[0] - 2 * score + around[1]).clamp(max=-1e-9)
        fine = shift + (0.5 * (around[0] - around[1]) / bend).clamp(-0.5, 0.5)
        roll = torch.remainder(fine / self._sectors * 2 * torch.pi + torch.pi, 2 * torch.pi) - torch.pi
        return ScanResult(score, roll)
