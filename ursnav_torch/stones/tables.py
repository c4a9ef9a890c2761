"""Stones as files: those of a scan in, those that pictures showed out."""

from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.columns import KNOWN_STONE_COLUMNS, STONE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import write_csv
from ursnav_torch.kidney import Kidney
from ursnav_torch.stones.known import KnownStone, StoneList
from ursnav_torch.stones.words import calyx_name
from ursnav_torch.tables import number, read_csv

#: ``state`` of a stone of the scan that no picture showed.
NOT_FOUND = "not found"


def read_known_stones(path: Path) -> tuple[KnownStone, ...]:
    """The stones of a scan, as `segment` writes them.

    Raises:
        InputError: the file cannot be read, a name is blank or stands twice, a size is not above 0.
    """
    found: list[KnownStone] = []
    for row in read_csv(path, KNOWN_STONE_COLUMNS, "stones"):
        name, size = row["stone"].strip(), number(row, "size_mm")
        if not name or name in {k.name for k in found} or size <= 0:
            raise InputError(
                f"{path}, line {row.line}: stone {name!r} of {size:g} mm; every stone has a name of its own and a size "
                "above 0."
            )
        found.append(KnownStone(name, np.array([number(row, c) for c in ("x_mm", "y_mm", "z_mm")]), size))
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
