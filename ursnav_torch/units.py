"""Units of lengths in tables: what columns' names say, what the user says by name, and whether it can be.

A column ``x_mm`` may hold centimeters all the same. Points of a kidney are compared with it: what lies in it, or is
spread over it, only in another unit than was said is refused until the user names the unit.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.tables import Row, numbers

Array = NDArray[np.float64]

#: mm a unit of length, by what stands behind ``x_`` in a column's name.
LENGTH_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
#: Points of a kidney lie no farther outside its box than this, mm.
_ASIDE_MM = 20.0
#: What lies in a kidney in mm and in centimeters, too, is spread over less than a tenth of it in mm, and over no less
#: than this in the other unit, or it is a few places close to one another.
_TENTH, _SPREAD = 0.1, 0.2


def check_unit(unit: str | None, option: str) -> str | None:
    """The unit that the user gave by ``option``, None for none.

    Raises:
        InputError: it is none that is known.
    """
    if unit is not None and unit not in LENGTH_MM:
        raise InputError(f"{option} is {unit!r}; accepted are {', '.join(LENGTH_MM)}, and null.")
    return unit


def length_columns(names: Sequence[str], prefix: str = "") -> tuple[list[str], float]:
    """The columns ``x_mm,y_mm,z_mm`` or those of another unit, and mm a unit; those of mm where there are none."""
    for unit, mm in LENGTH_MM.items():
        columns = [f"{prefix}{c}_{unit}" for c in "xyz"]
        if all(column in names for column in columns):
            return columns, mm
    return [f"{prefix}{c}_mm" for c in "xyz"], 1.0


def points_of_rows(rows: Sequence[Row], prefix: str = "", unit: str | None = None) -> Array:
    """Points (N, 3) in mm; NaN where a cell is blank. ``unit`` is the user's word, which counts before the names'.

    Raises:
        InputError: a cell is no number.
    """
    columns, mm = length_columns(list(rows[0]), prefix)
    return numbers(rows, columns) * (mm if unit is None else LENGTH_MM[unit])


def other_units(points_mm: Array, fits: Callable[[Array], bool]) -> list[str]:
    """The units besides mm in which points (N, 3) fit that are said to be in mm."""
    return [unit for unit, mm in LENGTH_MM.items() if mm != 1 and fits(points_mm * mm)]


def check_in_box(points_mm: Array, box_mm: Array, what: str, option: str = "") -> None:
    """Refuse points (N, 3) that fit a kidney's box (2, 3) in another unit than mm alone.

    Args:
        points_mm: as they were read.
        box_mm: corners of the kidney.
        what: names them and their file, for people to read.
        option: by which the user says their unit; "": by none, they must be in mm.

    Raises:
        InputError: see there.
    """
    box, size = np.asarray(box_mm, float), float(np.linalg.norm(np.ptp(box_mm, axis=0)))

    def inside(points: Array) -> bool:
        return bool(((points >= box[0] - _ASIDE_MM) & (points <= box[1] + _ASIDE_MM)).all())

    def spread(points: Array) -> float:
        return float(np.linalg.norm(np.ptp(points, axis=0)))

    here = inside(points_mm)
    close = len(points_mm) > 1 and spread(points_mm) < _TENTH * size
    units = other_units(points_mm, lambda p: inside(p) and (not here or (close and spread(p) >= _SPREAD * size)))
    if units:
        said = f"are spread over {spread(points_mm):.2g} mm" if here else "lie outside the kidney"
        mend = f"{_named(units)}, or say {option}=; if they are right, {option}=mm" if option else "write them in mm"
        raise InputError(f"{what} {said}, and fit the kidney if they are in {' or '.join(units)}: {mend}.")


def check_spread(points_mm: Array, range_mm: tuple[float, float], what: str, option: str) -> None:
    """Refuse points (N, 3) of a kidney that is not known, whose spread is none of such points in mm.

    Raises:
        InputError: see there; ``what`` and ``option`` as in `check_in_box`.
    """
    known = points_mm[np.isfinite(points_mm).all(axis=1)]
    size = float(np.linalg.norm(np.ptp(known, axis=0))) if len(known) > 2 else 0.0
    if size == 0 or range_mm[0] <= size <= range_mm[1]:
        return
    raise InputError(
        f"{what} are spread over {size:.3g} mm; those of a kidney over {range_mm[0]:g} to {range_mm[1]:g} mm. If they "
        f"are in another unit ({', '.join(LENGTH_MM)}), {_named(['cm'])}, or say {option}=; if they are right, "
        f"{option}=mm."
    )


def _named(units: list[str]) -> str:
    return f"name the columns so ({' or '.join(f'x_{unit}, y_{unit}, z_{unit}' for unit in units)})"
