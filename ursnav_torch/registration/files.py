"""Landmarks from CSV."""

from dataclasses import dataclass
from pathlib import Path

from ursnav_torch.geometry import Array
from ursnav_torch.tables import check_columns, numbers, read_csv
from ursnav_torch.units import check_spread, check_unit, length_columns, points_of_rows

_AXIS = ("em_dx", "em_dy", "em_dz")
#: Landmarks of a kidney lie no closer together, and no farther apart, mm; phantoms are printed up to five times as
#: large as life.
_SPREAD_MM = (12.0, 1000.0)
#: The setting that says their unit.
_OPTION = "landmarks_unit"


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


def read_landmarks(path: str | Path, unit: str | None = None) -> Landmarks:
    """Read ``kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm`` and, where there, ``em_dx,em_dy,em_dz``.

    Columns in another unit say so (``em_x_cm``; m, in), on either side.

    Args:
        path: the CSV file.
        unit: the user's word on all lengths, before the columns'.

    Raises:
        InputError: the file cannot be read, a column is missing, a value is no number, or the points are spread over
            what no landmarks of a kidney are in mm.
    """
    rows = read_csv(path, (), "landmark")
    wanted = [*length_columns(list(rows[0]), "kidney_")[0], *length_columns(list(rows[0]), "em_")[0]]
    check_columns(rows[0], wanted, path, "landmark")
    kidney_mm, em_mm = (points_of_rows(rows, side, check_unit(unit, _OPTION)) for side in ("kidney_", "em_"))
    if unit is None:
        for points, side in ((kidney_mm, "kidney"), (em_mm, "EM")):
            check_spread(points, _SPREAD_MM, f"The {side} points of {path}", _OPTION)
    has_axis = set(_AXIS) <= rows[0].keys()
    return Landmarks(em_mm, kidney_mm, numbers(rows, _AXIS) if has_axis else None)
