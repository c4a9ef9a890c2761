"""A phantom's files: two halves, where its landmarks are, what was measured, and a picture."""

import json
from pathlib import Path

import numpy as np

from ursnav_torch.files import whole_folder, write_csv, write_image
from ursnav_torch.kidney.tables import write_calyces
from ursnav_torch.printing.measure import PrintCheck, check_print
from ursnav_torch.printing.phantom import PrintedPhantom
from ursnav_torch.printing.picture import print_picture


def write_phantom(phantom: PrintedPhantom, out: Path, overwrite: bool = False) -> PrintCheck:
    """Write a phantom into a folder, whole or not at all, and return its measures.

    The folder holds ``half_a.stl`` (with the pins), ``half_b.stl``, ``landmarks.csv`` with the columns that `register`
    takes (EM blank), ``calyces.csv``, ``print.json`` and ``picture.png``. Coordinates are the kidney's times its scale.

    Raises:
        InputError: ``out`` exists.
    """
    with whole_folder(out, overwrite) as work:
        check = _write_all(phantom, work)
    return check


def _write_all(phantom: PrintedPhantom, work: Path) -> PrintCheck:
    for half, name in zip(phantom.halves, ("half_a", "half_b"), strict=True):
        half.export(work / f"{name}.stl")
    columns = ("name", "kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    points = enumerate(phantom.landmarks_mm.tolist())
    write_csv(
        work / "landmarks.csv",
        columns,
        [dict(zip(columns, (f"L{i + 1}", *point), strict=False)) for i, point in points],
    )
    write_calyces(work / "calyces.csv", phantom.kidney.calyces, phantom.kidney.pelvis_mm)
    write_image(work / "picture.png", print_picture(phantom))
    check = check_print(phantom)
    about = {
        "source": phantom.kidney.source,
        "scale": phantom.kidney.scale,
        "wall_mm": phantom.wall_mm,
        "cut": {
            "normal": np.round(phantom.cut.normal, 6).tolist(),
            "offset_mm": round(phantom.cut.offset_mm, 4),
            "calyces_crossed": [phantom.kidney.calyces[c].name for c in phantom.cut.crossed],
        },
        **check.to_dict(),
    }
    (work / "print.json").write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return check
