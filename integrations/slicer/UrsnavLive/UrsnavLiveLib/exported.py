"""Which files of an export are loaded as what."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: What `ursnav export to=slicer` writes, and stones where somebody has them: name, and kind of Slicer's node.
FILES = {
    "kidney.stl": "model",
    "calyces.mrk.json": "markups",
    "path.mrk.json": "markups",
    "landmarks.mrk.json": "markups",
    "em_to_kidney.tfm": "transform",
    "stones.csv": "stones",
}


@dataclass(frozen=True)
class Exported:
    """A file to be loaded: ``kind`` is a value of `FILES`, ``name`` the node's."""

    path: Path
    kind: str
    name: str


def find_exports(folder):
    """The files of a folder that can be loaded, in the order of `FILES`.

    Raises:
        ValueError: it has none, so that it is no export.
    """
    folder = Path(folder)
    found = [Exported(folder / name, kind, name.split(".")[0]) for name, kind in FILES.items()
             if (folder / name).is_file()]  # fmt: skip
    if not found:
        raise ValueError(f"{folder} holds nothing of what `ursnav export to=slicer` writes: {', '.join(FILES)}.")
    return found


def read_stones(path, frame):
    """Names and places (N, 3), RAS, of a table ``stone,calyx,x_mm,y_mm,z_mm,size_mm``.

    Args:
        path: the table.
        frame: ``lps`` or ``ras``, the kidney's coordinates.

    Raises:
        ValueError: it is no such table, or the frame is another.
    """
    if frame not in ("lps", "ras"):
        raise ValueError(f"the frame is {frame!r}; accepted are lps and ras")
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = list(csv.DictReader(file))
    try:
        at = np.array([[float(row[c]) for c in ("x_mm", "y_mm", "z_mm")] for row in rows]).reshape(-1, 3)
        names = tuple(f"{row['stone']} ({row['size_mm']} mm)" for row in rows)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is no table of stones: {error}") from None
    return names, at * ([-1.0, -1.0, 1.0] if frame == "lps" else [1.0, 1.0, 1.0])
