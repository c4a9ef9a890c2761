"""Where a view has edges and which way they run, one byte a bin, laid out so that a query point is one table row.

The score of a view is the sum of its bytes at the query's points: a coarse chamfer match with directions, as in
Shotton, Blake, Cipolla, PAMI 2008, but all views at once. Missing edges cost nothing, clutter adds no more than
chance does, and turned, shifted or scaled queries are further sums.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.errors import InputError

Bytes = NDArray[np.uint8]

#: Score of a point in a bin that the view fills, and in one beside it.
_HIT, _NEAR = 2, 1
#: More points than this are thinned out: their sum must fit one byte.
MOST_POINTS = 255 // _HIT


@dataclass(frozen=True, slots=True)
class Occupancy:
    """The bins and the search.

    Attributes:
        low_px: (x, y) of the grid's corner.
        high_px: (x, y) of the opposite corner; points outside count for the bin at the border.
        cells: bins along each side of the grid.
        orientations: bins of the edge direction (modulo pi).
        rolls_deg: rolls of the query about the grid's middle that are tried.
        scales: enlargements of the query about the grid's middle that are tried.
        shifts_px: shifts along x and along y that are tried, all pairs of them.
    """

    low_px: tuple[float, float]
    high_px: tuple[float, float]
    cells: int = 24
    orientations: int = 6
    rolls_deg: tuple[float, ...] = (-3.5, 0.0, 3.5)
    scales: tuple[float, ...] = (0.97, 1.03)
    shifts_px: tuple[float, ...] = (-12.0, 0.0, 12.0)

    def __post_init__(self) -> None:
        if self.cells < 2 or self.orientations < 1:
            raise InputError(f"Expected cells >= 2 and orientations >= 1, got {self.cells}, {self.orientations}.")
        if not all(h > low for low, h in zip(self.low_px, self.high_px, strict=True)):
            raise InputError(f"high_px must be beyond low_px, got {self.low_px} and {self.high_px}.")
        if not (self.rolls_deg and self.scales and self.shifts_px):
            raise InputError("rolls_deg, scales and shifts_px need one number each at least.")

    @property
    def bins(self) -> int:
        """Rows of the table."""
        return self.cells**2 * self.orientations

    def poses(self) -> list[tuple[float, float, float, float]]:
        """Roll in radians, scale and shift (x, y) of every hypothesis."""
        rolls = [math.radians(r) for r in self.rolls_deg]
        return list(itertools.product(rolls, self.scales, self.shifts_px, self.shifts_px))


def cell_indices(points: Tensor, direction: Tensor, settings: Occupancy) -> tuple[Tensor, Tensor, Tensor]:
    """Column, row and orientation bin (..., N), each int64, of points (..., N, 2) px with directions (..., N)."""
    low, high = torch.tensor(settings.low_px), torch.tensor(settings.high_px)
    place = ((points - low) / (high - low) * settings.cells).floor().clamp_(0, settings.cells - 1).long()
    turns = (direction / math.pi * settings.orientations).floor().long() % settings.orientations
    return place[..., 0], place[..., 1], turns


def fill(points: Tensor, mask: Tensor, direction: Tensor, settings: Occupancy) -> Bytes:
    """The table's columns (bins, B) of B views: points (B, P, 2) px, mask (B, P), direction (B, P) radians."""
    b, cells, turns = len(points), settings.cells, settings.orientations
    x, y, turn = cell_indices(points, direction, settings)
    out = torch.zeros(b, turns, cells + 2, cells + 2, dtype=torch.uint8)  # a rim takes what falls outside
    flat, each = out.view(b, -1), torch.where(mask, 1, 0).to(torch.uint8)
    for dt, dy, dx in itertools.product((-1, 0, 1), (-1, 0, 1), (-1, 0, 1)):
        index = (((turn + dt) % turns) * (cells + 2) + y + 1 + dy) * (cells + 2) + x + 1 + dx
        flat.scatter_reduce_(1, index, each * _NEAR, "amax")
    index = (turn * (cells + 2) + y + 1) * (cells + 2) + x + 1
    flat.scatter_reduce_(1, index, each * _HIT, "amax")
    inner = out[:, :, 1:-1, 1:-1].reshape(b, -1)
    return inner.T.contiguous().numpy()


def table_rows(points: Tensor, direction: Tensor, settings: Occupancy) -> NDArray[np.int64]:
    """Table rows (hypotheses, N) of a query's points (N, 2) px with directions (N,)."""
    middle = (torch.tensor(settings.low_px) + torch.tensor(settings.high_px)) / 2
    rows = []
    for roll, scale, shift_x, shift_y in settings.poses():
        c, s = scale * math.cos(roll), scale * math.sin(roll)
        moved = (points - middle) @ torch.tensor([[c, s], [-s, c]]) + middle + torch.tensor([shift_x, shift_y])
        x, y, turn = cell_indices(moved, direction + roll, settings)
        rows.append((turn * settings.cells + y) * settings.cells + x)
    return torch.stack(rows).numpy()


def best_sums(table: Bytes, rows: NDArray[np.int64], part: slice) -> Bytes:
    """Greatest sum (K,) over the hypotheses (H, N) of a table's bytes, for a slice of its columns."""
    best = np.zeros(part.stop - part.start, np.uint8)
    total = np.empty_like(best)
    for hypothesis in rows:
        total[:] = table[hypothesis[0], part]
        for row in hypothesis[1:]:
            np.add(total, table[row, part], out=total)
        np.maximum(best, total, out=best)
    return best
