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
#: A view of which less than this share of its contrast lies where the picture is valid is not scaled up any more.
LEAST_ENERGY = 0.15


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
        self._sectors, self._rings = maps.shape[-1], maps.shape[-2]
        self._weight = weight
        self._kept = min(FREQUENCIES, self._sectors // 2)
        self._spectrum = self._of_views(maps)
        self._maps, self._energies = maps, torch.zeros(0)

    def __len__(self) -> int:
        return self._spectrum.shape[1]

    def scan(self, maps: Tensor, views: Tensor | None = None, valid: Tensor | None = None) -> ScanResult:
        """Compare a query's maps with views.

        Args:
            maps: (N, C, R, A), one row a tilt; each channel group of unit length.
            views: (K,) rows of the views; all when None.
            valid: (N, R, A) 0 to 1, where the maps, zero elsewhere, are valid. Then a view's contrast, too, counts
                only there: masked normalized correlation (Padfield, IEEE TIP 21:2706, 2012). None: everywhere.
        """
        spectrum = self._spectrum if views is None else self._spectrum[:, views]
        if valid is None:
            return self._best(self._over_shift(maps.float() * self._weight[:, None, None], spectrum))
        energy = self._energy() if views is None else self._energy()[:, views]
        total, width = torch.zeros(()), 2 * self._rings  # real numbers a channel
        for row, group in enumerate(groups(len(self._weight))):
            own = spectrum[..., group.start * width : group.stop * width]
            there = self._over_shift(valid[:, None], energy[..., row * width : (row + 1) * width])
            alike = self._over_shift(maps[:, group].float() * self._weight[group, None, None], own)
            total = total + alike / there.clamp_min(LEAST_ENERGY).sqrt()
        return self._best(total)

    def _of_views(self, maps: Tensor) -> Tensor:
        """Spectra (F, V, C R 2) of maps (V, C, R, A)."""
        views, channels, rings, _ = maps.shape
        spectrum = torch.empty(self._kept, views, channels * rings, dtype=torch.complex64)
        for some, out in zip(maps.split(_VIEWS_AT_A_TIME), spectrum.split(_VIEWS_AT_A_TIME, 1), strict=True):
            out.copy_(torch.fft.rfft(some.float())[..., : self._kept].flatten(1, 2).permute(2, 0, 1))
        return torch.view_as_real(spectrum).flatten(2)

    def _energy(self) -> Tensor:
        """Spectra (F, V, G R 2) of what contrast each channel group has; made when they are first asked for."""
        if not len(self._energies):
            squares = [self._maps[:, group].float().square().sum(1) for group in groups(len(self._weight))]
            self._energies = self._of_views(torch.stack(squares, 1))
        return self._energies

    def _over_shift(self, maps: Tensor, spectrum: Tensor) -> Tensor:
        """Products (K, N, A) of maps (N, C, R, A) with views, whose spectra are (F, K, C R 2), at every shift."""
        query = torch.fft.rfft(maps)[..., : self._kept].flatten(1, 2).permute(2, 1, 0)  # (F, C R, N)
        rows = torch.stack([torch.view_as_real(query), torch.view_as_real(-1j * query)])  # (2, F, CR, N, 2)
        rows = rows.permute(1, 3, 0, 2, 4).flatten(3).flatten(1, 2)  # (F, N 2, CR 2)
        product = torch.bmm(rows, spectrum.transpose(1, 2))  # the views last, which is faster than the views first
        product = product.view(self._kept, len(maps), 2, -1).permute(3, 1, 0, 2)  # (K, N, F, 2)
        return torch.fft.irfft(torch.complex(product[..., 0], -product[..., 1]), n=self._sectors)

    def _best(self, over_shift: Tensor) -> ScanResult:
        """The best shift and tilt of products (K, N, A)."""
        score, at = over_shift.flatten(1).max(1)
        tilt, shift = at // self._sectors, at % self._sectors
        row = over_shift[torch.arange(len(score)), tilt]
        before, after = (row.gather(1, ((shift + d) % self._sectors)[:, None])[:, 0] for d in (-1, 1))
        bend = (before - 2 * score + after).clamp(max=-1e-9)
        fine = shift + (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
        roll = torch.remainder(fine / self._sectors * 2 * torch.pi + torch.pi, 2 * torch.pi) - torch.pi
        return ScanResult(score, tilt, roll)


def groups(channels: int) -> list[slice]:
    """Channels that were brought to unit length together: the relief, then pairs."""
    return [slice(0, 1), *(slice(c, c + 2) for c in range(1, channels, 2))]


def tilts(step_deg: float, rounds: int) -> NDArray[np.float64]:
    """Rotations (N, 3, 3) that tilt a camera by up to ``rounds`` steps every way, the first of them not at all."""
    turns = [np.zeros(3)]
    for k in range(1, rounds + 1):
        for around in np.arange(6 * k) / (6 * k) * 2 * np.pi:
            turns.append(np.radians(step_deg * k) * np.array([np.cos(around), np.sin(around), 0.0]))
    return Rotation.from_rotvec(np.array(turns)).as_matrix()
