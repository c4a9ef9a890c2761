"""Calyces and centerlines as CSV files."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Calyx, Centerline
from ursnav_torch.tables import Row, check_columns, number, read_csv, whole_number
from ursnav_torch.units import check_in_box, check_unit, length_columns, points_of_rows

Array = NDArray[np.float64]

_POINT = ("x_mm", "y_mm", "z_mm")


def write_calyces(path: Path | str, calyces: Sequence[Calyx], pelvis_mm: Array | None = None) -> None:
    """Write `calyx,x_mm,y_mm,z_mm,pole`, a row a calyx (kidney frame, tips), after a row `pelvis` if that is given.

    ``pelvis_mm`` is (3,), kidney frame.
    """
    rows = [] if pelvis_mm is None else [("pelvis", pelvis_mm, "")]
    rows += [(c.name, c.tip_mm, c.pole) for c in calyces]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("calyx", *_POINT, "pole"))
        writer.writerows((name, *(f"{x:.4f}" for x in point), pole) for name, point, pole in rows)


def read_calyces(path: Path | str, unit: str | None = None) -> tuple[tuple[Calyx, ...], Array | None]:
    """Calyces of a file with the columns `calyx,x_mm,y_mm,z_mm` and perhaps `pole`, and the row `pelvis` (3,) if there.

    Further columns are passed over; points are in the kidney frame. Columns in another unit say so (``x_cm``, m, in);
    ``unit`` is the user's word, which counts before theirs.

    Raises:
        InputError: the file is missing, has no such columns or no calyx, a name is empty or twice, a number is none.
    """
    if str(path).lower().endswith(".json"):
        raise InputError(
            f"{path} holds markups of 3D Slicer, which kidney=ct takes; a mesh does not say if it is in LPS or RAS. "
            "Give it a CSV calyx,x_mm,y_mm,z_mm in the mesh's own coordinates."
        )
    rows = read_csv(path, ("calyx",), "calyces")
    columns, _ = length_columns(list(rows[0]))
    check_columns(rows[0], columns, path, "calyces")
    names = [row["calyx"].strip() for row in rows]
    for name, row in zip(names, rows, strict=True):
        if not name or names.count(name) > 1:
            raise InputError(
                f"{path}, line {row.line}: the calyx name {name!r} is {'used twice' if name else 'empty'}; name each "
                "one once."
            )
    for row in rows:
        for column in columns:
            number(row, column)
    points = list(points_of_rows(rows, "", check_unit(unit, "kidney.calyces_unit")))
    pelvis = next((p for n, p in zip(names, points, strict=True) if n.lower() == "pelvis"), None)
    calyces = tuple(
        _calyx(name, point, row)
        for name, point, row in zip(names, points, rows, strict=True)
        if name.lower() != "pelvis"
    )
    if not calyces:
        raise InputError(f"{path} names no calyx; give at least one row calyx,x_mm,y_mm,z_mm besides the pelvis.")
    return calyces, pelvis


def _calyx(name: str, tip_mm: Array, row: Row) -> Calyx:
    try:
        return Calyx(name, tip_mm, row.get("pole", "").strip())
    except InputError as error:
        raise InputError(f"{row.path}, line {row.line}: {error}") from None


def check_given(calyces: Sequence[Calyx], box_mm: Array, path: str) -> None:
    """Refuse tips that fit the kidney's box (2, 3) in another unit than mm alone, see `check_in_box`."""
    tips = np.array([c.tip_mm for c in calyces])
    check_in_box(tips, box_mm, f"The {len(tips)} calyces of {path}", "kidney.calyces_unit")


def write_centerline(path: Path | str, centerline: Centerline, names: Sequence[str]) -> None:
    """Write `node,parent,calyx,x_mm,y_mm,z_mm,radius_mm`; ``names`` are the calyces' in their order.

    `parent` is -1 at the root; `calyx` is blank where a node leads to several.
    """
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("node", "parent", "calyx", *_POINT, "radius_mm"))
        for node, (point, radius) in enumerate(zip(centerline.points_mm, centerline.radius_mm, strict=True)):
            calyx = centerline.calyx[node]
            numbers = (f"{x:.4f}" for x in (*point, radius))
            writer.writerow((node, centerline.parent[node], "" if calyx < 0 else names[calyx], *numbers))


def read_centerline(path: Path | str, names: Sequence[str]) -> Centerline:
    """The centerline of a file by `write_centerline`; ``names`` are the calyces' in their order.

    Raises:
        InputError: the file is missing or damaged, or names a calyx that is not among ``names``.
    """
    rows = read_csv(path, ("node", "parent", "calyx", *_POINT, "radius_mm"), "centerline")
    unknown = {row["calyx"] for row in rows} - {"", *names}
    if unknown:
        raise InputError(f"{path} leads to calyces {sorted(unknown)}, but the calyces are {list(names)}.")
    parent = np.array([whole_number(row, "parent") for row in rows])
    if not len(rows) or parent[0] != -1 or np.any(parent[1:] < 0) or np.any(parent >= np.arange(len(rows))):
        raise InputError(f"{path} is not a tree with every parent before its children; write it anew from the kidney.")
    calyx = np.array([names.index(row["calyx"]) if row["calyx"] else -1 for row in rows])
    points = np.array([[number(row, key) for key in _POINT] for row in rows])
    return Centerline(points, np.array([number(row, "radius_mm") for row in rows]), parent, calyx)
