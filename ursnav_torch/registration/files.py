"""Landmarks from CSV."""

from dataclasses import dataclass
from pathlib import Path

from ursnav_torch.columns import LANDMARK_COLUMNS
from ursnav_torch.geometry import Array
from ursnav_torch.tables import numbers, read_csv

_AXIS = ("em_dx", "em_dy", "em_dz")


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Pairs of points.

    Attributes:
        em_mm, kidney_mm: (N, 3) in the two frames.
        em_axis: (N, 3) the sensor's axis at each touch, or None.
    """

    em_mm: Array
    kidney_mm: Array
    em_axis: Array | None = None


def read_landmarks(path: str | Path) -> Landmarks:
    """Read ``kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm`` and, where there, ``em_dx,em_dy,em_dz``.

    Raises:
        InputError: the file cannot be read, a column is missing or a value is no number.
    """
    rows = read_csv(path, LANDMARK_COLUMNS, "landmark")
    table = numbers(rows, LANDMARK_COLUMNS)
    has_axis = set(_AXIS) <= rows[0].keys()
    return Landmarks(table[:, 3:], table[:, :3], numbers(rows, _AXIS) if has_axis else None)
