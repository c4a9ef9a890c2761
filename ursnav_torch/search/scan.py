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
#: Frequencies of a first look at all views, which passes on eight times as many as are kept in the end. Set by hand:
#: right answers stay as many (`benchmarks.causes work=DIR phantoms=2`).
FEW_FREQUENCIES = 10
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
        self._waves = _waves(self._kept, self._sectors)
        self._groups = groups(len(weight))
        self._spectra = self._of_views(maps)
        self._maps, self._energies = maps, list[Tensor]()

    def __len__(self) -> int:
        return self._spectra.shape[1]

    def scan(self, maps: Tensor, views: Tensor | None = None, valid: Tensor | None = None) -> ScanResult:
        """Compare a query's maps with views.

        Args:
            maps: (N, C, R, A), one row a tilt; each channel group of unit length.
            views: (K,) rows of the views; all when None.
            valid: (N, R, A) 0 to 1, where the maps, zero elsewhere, are valid. Then a view's contrast, too, counts
                only there: masked normalized correlation (Padfield, IEEE TIP 21:2706, 2012). None: everywhere.
        """
        return self._best(self._correlations(maps, views, valid))

    def first_look(self, maps: Tensor, views: Tensor | None = None, valid: Tensor | None = None) -> Tensor:
        """About `scan`'s scores (K,), by `FEW_FREQUENCIES` alone, which are most of a map; the same arguments."""
        return self._correlations(maps, views, valid, min(FEW_FREQUENCIES, self._kept)).amax((0, 1))

    def _correlations(
        self, maps: Tensor, views: Tensor | None, valid: Tensor | None, frequencies: int | None = None
    ) -> Tensor:
        """Weighted correlations (A, N, K) of N maps with K views at every shift, of the lowest frequencies or of all;
        arguments as of `scan`."""
        weighted, spectra = maps.float() * self._weight[:, None, None], _of(self._spectra[:frequencies], views)
        if valid is None:
            return self._over_shift(self._products(weighted, spectra), len(maps))
        total = torch.zeros(1)
        for group, energy in zip(self._groups, self._energy(), strict=True):  # masks weigh the groups apart
            own = slice(group.start * 2 * self._rings, group.stop * 2 * self._rings)
            there = self._over_shift(self._products(valid[:, None], _of(energy[:frequencies], views)), len(maps))
            alike = self._over_shift(self._products(weighted[:, group], spectra[..., own]), len(maps))
            total = total + alike.mul_(there.clamp_min_(LEAST_ENERGY).rsqrt_())
        return total

    def _of_views(self, maps: Tensor) -> Tensor:
        """Spectra (F, V, C R 2) of maps (V, C, R, A)."""
        views, channels, rings, _ = maps.shape
        spectrum = torch.empty(self._kept, views, channels * rings, dtype=torch.complex64)
        for some, out in zip(maps.split(_VIEWS_AT_A_TIME), spectrum.split(_VIEWS_AT_A_TIME, 1), strict=True):
            out.copy_(torch.fft.rfft(some.float())[..., : self._kept].flatten(1, 2).permute(2, 0, 1))
        return torch.view_as_real(spectrum).flatten(2)

    def _energy(self) -> list[Tensor]:
        """Spectra (F, V, R 2) of what contrast each channel group has; made when they are first asked for."""
        if not self._energies:
            self._energies = [self._of_views(self._maps[:, g].float().square().sum(1, True)) for g in self._groups]
        return self._energies

    def _products(self, maps: Tensor, spectrum: Tensor) -> Tensor:
        """Products (F 2, N K) of maps (N, C, R, A) with views, whose spectra are (F, K, C R 2)."""
        query = torch.fft.rfft(maps)[..., : len(spectrum)].flatten(1, 2).permute(2, 0, 1)  # (F, N, C R)
        rows = torch.stack([torch.view_as_real(query), torch.view_as_real(-1j * query)], 1)  # (F, 2, N, CR, 2)
        product = torch.bmm(rows.flatten(3).flatten(1, 2), spectrum.transpose(1, 2))  # the views last: that is faster
        return product.view(2 * len(spectrum), -1)

    def _over_shift(self, products: Tensor, count: int) -> Tensor:
        """Correlations (A, N, K) at every shift of products (F 2, N K) of ``count`` = N maps."""
        return (self._waves[:, : len(products)] @ products).view(self._sectors, count, -1)

    def _best(self, over_shift: Tensor) -> ScanResult:
        """The best shift and tilt of products (A, N, K)."""
        sectors, views = self._sectors, over_shift.shape[2]
        score, tilt = over_shift.amax(0).max(0)
        row = over_shift.gather(1, tilt.expand(sectors, 1, views))[:, 0].T.contiguous()  # (K, A)
        shift = row.argmax(1)
        before, after = (row.gather(1, ((shift + d) % sectors)[:, None])[:, 0] for d in (-1, 1))
        bend = (before - 2 * score + after).clamp(max=-1e-9)
        fine = shift + (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
        roll = torch.remainder(fine / sectors * 2 * torch.pi + torch.pi, 2 * torch.pi) - torch.pi
        return ScanResult(score, tilt, roll)


def _of(spectrum: Tensor, views: Tensor | None) -> Tensor:
    """Spectra (F, V, ...) of some views (K,), of all where None."""
    return spectrum if views is None else spectrum.index_select(1, views)


def _waves(frequencies: int, sectors: int) -> Tensor:
    """The inverse transform of real signals (A,), of whose spectra F real and imaginary parts are kept, the latter
    negated, as a matrix (A, F 2): a product with it is faster than an FFT of so few."""
    angle = 2 * torch.pi / sectors * torch.arange(sectors)[:, None] * torch.arange(frequencies).double()
    share = torch.full((frequencies,), 2.0 / sectors, dtype=torch.float64)
    share[0] /= 2
    return torch.stack([share * angle.cos(), share * angle.sin()], 2).flatten(1).float()


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
