"""Scanning the VID at every roll and at small tilts: polar maps correlated over their shift by FFT.

Turning a camera on the spot changes its picture in a way that needs no depth, so a view stands for all directions
near its own: the VID has to be dense in places, not in directions.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

#: Frequencies around the axis that are kept; the maps hold nothing finer than 360 / 24 = 15 degrees of detail.
FREQUENCIES = 24
#: Views transformed at a time, so that what is cut off again never leaves the second-level cache.
_VIEWS_AT_A_TIME = 16


@dataclass(frozen=True, slots=True)
class ScanResult:
    """How well views' maps fit a query's, at the tilt and roll that suit each best.

    Attributes:
        score: (K,) weighted sum of the channels' correlations.
        tilt: (K,) int64, row of the query's maps.
        roll: (K,) radians in [-pi, pi): ``T_kidney_tilted = T_kidney_view @ Rz(roll)``.
    """

    score: Tensor
    tilt: Tensor
    roll: Tensor


class RollScan:
    """The spectra of all views' polar maps, ready to be correlated with a query's.

    Args:
        maps: (V, C, R, A) polar maps, each channel group of unit length.
        weight: (C,) weight of each channel's correlation.

    Memory: 8 V C R F bytes for F = 24 frequencies (42 MB for 2,160 views of 5 x 20 rings).
    """

    def __init__(self, maps: Tensor, weight: Tensor) -> None:
        self._sectors = maps.shape[-1]
        self._weight = weight
        self._kept = min(FREQUENCIES, self._sectors // 2)
        views, channels, rings, _ = maps.shape
        spectrum = torch.empty(self._kept, views, channels * rings, dtype=torch.complex64)
        for some, out in zip(maps.split(_VIEWS_AT_A_TIME), spectrum.split(_VIEWS_AT_A_TIME, 1), strict=True):
            out.copy_(torch.fft.rfft(some.float())[..., : self._kept].flatten(1, 2).permute(2, 0, 1))
        self._spectrum = torch.view_as_real(spectrum).flatten(2)

    def __len__(self) -> int:
        return self._spectrum.shape[1]

    def scan(self, maps: Tensor, views: Tensor | None = None) -> ScanResult:
        """Compare a query's maps (N, C, R, A), one row a tilt, with views (K,), or all when None."""
        query = torch.fft.rfft(maps.float() * self._weight[:, None, None])[..., : self._kept].flatten(1, 2)
        query = query.permute(2, 1, 0)  # (F, C R, N)
        rows = torch.stack([torch.view_as_real(query), torch.view_as_real(-1j * query)])  # (2, F, CR, N, 2)
        rows = rows.permute(1, 3, 0, 2, 4).flatten(3).flatten(1, 2)  # (F, N 2, CR 2)
        spectrum = self._spectrum if views is None else self._spectrum[:, views]
        product = torch.bmm(rows, spectrum.transpose(1, 2))  # the views last, which is faster than the views first
        product = product.view(self._kept, len(maps), 2, -1).permute(3, 1, 0, 2)  # (K, N, F, 2)
        over_shift = torch.fft.irfft(torch.complex(product[..., 0], -product[..., 1]), n=self._sectors)
        score, at = over_shift.flatten(1).max(1)
        tilt, shift = at // self._sectors, at % self._sectors
        row = over_shift[torch.arange(len(score)), tilt]
        before, after = (row.gather(1, ((shift + d) % self._sectors)[:, None])[:, 0] for d in (-1, 1))
        bend = (before - 2 * score + after).clamp(max=-1e-9)
        fine = shift + (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
        roll = torch.remainder(fine / self._sectors * 2 * torch.pi + torch.pi, 2 * torch.pi) - torch.pi
        return ScanResult(score, tilt, roll)


def tilts(step_deg: float, rounds: int) -> NDArray[np.float64]:
    """Rotations (N, 3, 3) that tilt a camera by up to ``rounds`` steps every way, the first of them not at all."""
    turns = [np.zeros(3)]
    for k in range(1, rounds + 1):
        for around in np.arange(6 * k) / (6 * k) * 2 * np.pi:
            turns.append(np.radians(step_deg * k) * np.array([np.cos(around), np.sin(around), 0.0]))
    return Rotation.from_rotvec(np.array(turns)).as_matrix()
