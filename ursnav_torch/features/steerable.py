"""Steerable principal components of polar maps: few numbers a picture, whose roll is a phase.

At each frequency around the optical axis a map is a complex vector over channels and rings, and a roll multiplies all
of it by one phase. Principal components of these vectors, one set a frequency, keep that: a picture's few numbers are
compared at every roll without its maps (Zhao, Shkolnisky and Singer, Fast steerable principal component analysis, IEEE
Transactions on Computational Imaging 2:1, 2016).
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class SteerableBasis:
    """K components of maps (C, R, A), those of most energy at any frequency.

    Attributes:
        frequency: (K,) int64 cycles around the axis of each.
        vectors: (K, C R, 2) float32, real and imaginary parts, of unit length.
        sectors: A.
    """

    frequency: Tensor
    vectors: Tensor
    sectors: int

    def __len__(self) -> int:
        return len(self.frequency)

    def coefficients(self, maps: Tensor) -> Tensor:
        """Coefficients (N, K) complex64 of maps (N, C, R, A), scaled so that a product of two is that of the maps."""
        spectrum = torch.fft.rfft(maps.float()).flatten(1, 2)  # (N, C R, F)
        counted = torch.where(self.frequency == 0, 1.0, 2.0) / self.sectors  # a real map holds f and -f alike
        out = torch.empty(len(maps), len(self), dtype=torch.complex64)
        vectors = torch.view_as_complex(self.vectors)
        for f in self.frequency.unique().tolist():
            own = self.frequency == f
            out[:, own] = spectrum[..., f] @ vectors[own].conj().T
        return out * counted.sqrt()

    def table(self, maps: Tensor) -> Tensor:
        """Coefficients (2 K, N) of maps (N, C, R, A), real parts first."""
        found = self.coefficients(maps).T
        return torch.cat([found.real, found.imag])

    def turned(self, maps: Tensor, rolls: int) -> Tensor:
        """Rows (rolls, 2 K) of one picture's maps (C, R, A) at so many rolls, evenly around the axis from 0 on.

        The product of row r and a column of `table` is the maps' correlation where the picture was rolled by
        ``r / rolls * 2 pi`` against the view, see `search.scan.ScanResult.roll`.
        """
        phase = self.frequency * (torch.arange(rolls)[:, None] * (2 * math.pi / rolls))
        rows = self.coefficients(maps[None]) * torch.polar(torch.ones(()), -phase)
        return torch.cat([rows.real, rows.imag], 1)


def learn_basis(maps: Tensor, components: int, most: int = 4096) -> SteerableBasis:
    """The ``components`` of most energy in maps (V, C, R, A); of more than ``most`` maps, that many spread evenly."""
    views, sectors = len(maps), maps.shape[-1]
    some = torch.linspace(0, views - 1, min(views, most)).round().long()
    spectrum = torch.fft.rfft(maps[some].float()).flatten(1, 2)  # (N, C R, F)
    energies, vectors, frequencies = [], [], []
    for f in range(spectrum.shape[-1]):
        at = spectrum[..., f].to(torch.complex128)
        energy, basis = torch.linalg.eigh(at.T @ at.conj())  # of the sum of x x^H
        energies.append(energy * (1.0 if f == 0 else 2.0))
        vectors.append(basis.T)
        frequencies.append(torch.full((len(energy),), f))
    kept = torch.cat(energies).topk(min(components, sum(map(len, energies)))).indices
    chosen, frequency = torch.cat(vectors)[kept].to(torch.complex64), torch.cat(frequencies)[kept]
    return SteerableBasis(frequency, torch.view_as_real(chosen.contiguous()), sectors)
