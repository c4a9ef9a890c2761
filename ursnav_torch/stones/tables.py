"""Stones as files: those of a scan in, those that pictures showed out."""

from pathlib import Path
from typing import Any

from ursnav_torch.columns import STONE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import write_csv
from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney
from ursnav_torch.stones.known import KnownStone, StoneList
from ursnav_torch.stones.words import calyx_name
from ursnav_torch.tables import check_columns, number, read_csv
from ursnav_torch.units import LENGTH_MM, check_in_box, check_unit, length_columns, points_of_rows

#: ``state`` of a stone of the scan that no picture showed.
NOT_FOUND = "not found"
#: Sizes of stones in lists of others: a scan shows none smaller, and none is larger, mm at scale 1 to 5.
_SIZE_MM = (1.0, 300.0)


def read_known_stones(path: Path, unit: str | None = None, box_mm: Array | None = None) -> tuple[KnownStone, ...]:
    """The stones of a scan, as `segment` writes them.

    Args:
        path: CSV ``stone,x_mm,y_mm,z_mm,size_mm``; columns in another unit say so (``x_cm``, ``size_cm``; m, in).
        unit: the user's word on all lengths, before the columns'.
        box_mm: (2, 3) corners of the kidney that they lie in.

    Raises:
        InputError: the file cannot be read, a name is blank or stands twice, a size or the places are none of stones
            in this kidney in mm.
    """
    rows = read_csv(path, (), "stones")
    columns, mm = length_columns(list(rows[0]))
    size_column = columns[0].replace("x_", "size_")
    check_columns(rows[0], ("stone", *columns, size_column), path, "stones")
    places = points_of_rows(rows, "", check_unit(unit, "known_stones_unit"))
    found: list[KnownStone] = []
    for row, place in zip(rows, places, strict=True):
        name, size = row["stone"].strip(), number(row, size_column) * (mm if unit is None else LENGTH_MM[unit])
        if not name or name in {k.name for k in found} or size <= 0:
            raise InputError(
                f"{path}, line {row.line}: stone {name!r} of {size:g} mm; every stone has a name of its own and a size "
                "above 0."
            )
        if unit is None and not _SIZE_MM[0] <= size <= _SIZE_MM[1]:
            raise InputError(
                f"{path}, line {row.line}: stone {name!r} of {size:g} mm; a stone that a scan shows has "
                f"{_SIZE_MM[0]:g} to {_SIZE_MM[1]:g} mm. If the lengths are in another unit, say known_stones_unit= "
                f"({', '.join(LENGTH_MM)}); if they are right, known_stones_unit=mm."
            )
        for column in columns:
            number(row, column)
        found.append(KnownStone(name, place, size))
    if unit is None and box_mm is not None:
        check_in_box(places, box_mm, f"The {len(found)} stones of {path}", "known_stones_unit")
    return tuple(found)


def write_stones(path: Path, stones: StoneList, kidney: Kidney) -> None:
    """Write ``FILE.stones.csv``: a row a stone seen, then one a stone of the scan that was not found."""
    rows: list[dict[str, Any]] = []
    for stone, known in zip(stones.seen, stones.known, strict=True):
        place = dict(zip(("x_mm", "y_mm", "z_mm"), stone.center_mm.round(3).tolist(), strict=True))
        rows.append({
            "stone": stone.number, "calyx": calyx_name(stone, kidney), **place, "size_mm": round(stone.size_mm, 2),
            "pictures": stone.pictures, "confidence": round(stone.confidence, 4),
            "size_sd_mm": round(stone.size_sd_mm, 2), "position_sd_mm": round(stone.position_sd_mm, 2),
            "state": stone.state, "known": known, "frame": stone.frame,
        })  # fmt: skip
    for missing in stones.not_found:
        place = dict(zip(("x_mm", "y_mm", "z_mm"), missing.center_mm.tolist(), strict=True))
        rows.append({"size_mm": missing.size_mm, "pictures": 0, **place, "state": NOT_FOUND, "known": missing.name})
    write_csv(path, STONE_COLUMNS, rows)
