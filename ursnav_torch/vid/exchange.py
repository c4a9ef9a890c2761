"""VIDs from and to elsewhere: pictures, poses as CSV, point sets as text, as the thesis kept them (§3.4)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import POSE_COLUMNS, UNITY_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import check_output, is_file, whole_folder, write_csv, write_image
from ursnav_torch.geometry import Array, check_rigid, transform_from_unity, transform_to_unity
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.tables import Row, number, read_csv
from ursnav_torch.units import check_in_box
from ursnav_torch.vid.base import Vid, image_name
from ursnav_torch.vid.plan import Plan
from ursnav_torch.vid.store import poses_from_rows

#: Anatomical mm a unit of the thesis's Unity scene: meters, everything 10.8 times as large as life (§3.3.2).
THESIS_MM_PER_UNIT = 1000 / 10.8
#: A view may stick this far through the wall, mm at scale 1: hands are no robots.
_OUTSIDE_MM = 3.0


@dataclass(frozen=True, slots=True)
class CollectedViews:
    """Views at places chosen elsewhere.

    Attributes:
        pictures: (V,) files; none where the views are to be drawn.
        T_kidney_camera: (V, 4, 4).
        calyx: (V,) names, blank for none; or None, and the rule of `observed_calyx` labels them.
        path: the CSV file they come from.
    """

    pictures: tuple[Path, ...]
    T_kidney_camera: Array
    calyx: tuple[str, ...] | None
    path: Path

    def plan(self, kidney: Kidney, lumen: LumenDistance) -> Plan:
        """These views as a plan for this kidney.

        Raises:
            InputError: a calyx is not among the kidney's, or views stand outside its lumen.
        """
        check_in_box(
            self.T_kidney_camera[:, :3, 3], kidney.mesh.bounds, f"The {len(self.T_kidney_camera)} views of {self.path}"
        )
        outside = lumen.clearance_mm(self.T_kidney_camera[:, :3, 3]) < -_OUTSIDE_MM * kidney.scale
        if outside.any():
            raise InputError(
                f"{outside.sum()} of the {len(outside)} views of {self.path} stand outside the lumen of "
                f"{kidney.source}, line {int(outside.argmax()) + 2} first: their poses must be in "
                "the kidney's own frame; check the columns (x_mm: mm, camera axes x right, y down, z forward; "
                "x_unity: Unity) and mm_per_unit."
            )
        if self.calyx is None:
            return Plan(self.T_kidney_camera, observed_calyx(self.T_kidney_camera, kidney, lumen))
        index = {c.name: i for i, c in enumerate(kidney.calyces)} | {"": -1}
        unknown = sorted(set(self.calyx) - set(index))
        if unknown:
            raise InputError(
                f"{self.path} names the calyces {', '.join(unknown)}; the kidney's are "
                f"{', '.join(name for name in index if name)}. Give both the same names "
                "(kidney.calyces=FILE), or leave the column out."
            )
        return Plan(self.T_kidney_camera, np.array([index[name] for name in self.calyx], np.int64))


def read_views(path: str | Path, mm_per_unit: float | None = None) -> CollectedViews:
    """Views collected elsewhere: a folder with ``poses.csv`` and pictures beside it or in ``images/``.

    Args:
        path: the folder. Columns of its ``poses.csv``: ``image``, perhaps ``calyx``, and either
            ``x_mm,y_mm,z_mm,qx,qy,qz,qw`` (`T_kidney_camera`) or ``x_unity,y_unity,z_unity,qx,qy,qz,qw`` (a
            camera in Unity: left-handed, y up, looking along +z; the scene's z is the kidney's, mirrored).
        mm_per_unit: mm of the kidney frame a Unity unit; None takes the column ``mm_per_unit``, else the thesis's.

    Raises:
        InputError: something is missing, or is not a pose.
    """
    folder = Path(path)
    table = folder / "poses.csv"
    rows = read_csv(table, ("image", "qx", "qy", "qz", "qw"), "poses")
    unity = UNITY_COLUMNS[0] in rows[0]
    missing = [c for c in (UNITY_COLUMNS if unity else POSE_COLUMNS) if c not in rows[0]]
    if missing:
        raise InputError(f"{table} lacks {', '.join(missing)}; needed are x_mm,y_mm,z_mm or x_unity,y_unity,z_unity.")
    T = _unity_poses(rows, table, mm_per_unit) if unity else poses_from_rows(rows)
    names = tuple(row["calyx"].strip() for row in rows) if "calyx" in rows[0] else None
    pictures = tuple(_picture(folder, row) for row in rows)
    return CollectedViews(pictures, check_rigid(T, f"A pose of {table}"), names, table)


def read_poses(path: str | Path) -> CollectedViews:
    """Places at which views are to be drawn: a CSV file ``x_mm,y_mm,z_mm,qx,qy,qz,qw``, perhaps ``calyx``.

    Raises:
        InputError: something is missing, or is not a pose.
    """
    table = Path(path)
    rows = read_csv(table, POSE_COLUMNS, "poses")
    names = tuple(row["calyx"].strip() for row in rows) if "calyx" in rows[0] else None
    T = check_rigid(poses_from_rows(rows), f"A pose of {table}")
    return CollectedViews((), T, names, table)


def export_thesis(vid: Vid, folder: Path, mm_per_unit: float = THESIS_MM_PER_UNIT, overwrite: bool = False) -> None:
    """Write a VID as the thesis kept its own; `read_views` reads it back.

    ``folder`` gets ``images/``, ``poses.csv`` (``image,calyx``, Unity's poses, and ``mm_per_unit`` in every row: what
    one of its units is in the kidney frame) and ``points/`` with a text file a view, ``x y`` in px a line.

    Raises:
        InputError: ``folder`` exists, or the VID lacks its pictures.
    """
    check_output(folder, overwrite)
    missing = [i for i in range(len(vid)) if not vid.image_path(i).exists()]
    if missing:
        raise InputError(
            f"The VID {vid.folder} lacks {len(missing)} of its pictures, {vid.image_path(missing[0])} first."
        )
    with whole_folder(folder, overwrite) as work:
        (work / "images").mkdir()
        for view, picture in enumerate(vid.pictures()):
            write_image(work / "images" / image_name(view), picture)
        (work / "points").mkdir()
        for view, (points, mask) in enumerate(zip(vid.features.points, vid.features.mask, strict=True)):
            np.savetxt(work / "points" / f"{view:06d}.txt", points[mask].numpy(), "%.3f")
        write_csv(work / "poses.csv", ("image", "calyx", *UNITY_COLUMNS, "mm_per_unit"), _unity_rows(vid, mm_per_unit))


def _unity_rows(vid: Vid, mm_per_unit: float) -> list[dict[str, Any]]:
    position, quaternion = transform_to_unity(vid.T_kidney_camera, mm_per_unit)
    values = np.concatenate([position, quaternion], axis=1).tolist()
    return [
        {"image": image_name(i), "calyx": vid.calyx_name(int(vid.calyx[i])), "mm_per_unit": mm_per_unit}
        | dict(zip(UNITY_COLUMNS, row, strict=True))
        for i, row in enumerate(values)
    ]


def _unity_poses(rows: list[Row], table: Path, mm_per_unit: float | None) -> Array:
    values = np.array([[number(row, c) for c in UNITY_COLUMNS] for row in rows])
    scale: NDArray[np.float64] | float = mm_per_unit or THESIS_MM_PER_UNIT
    if mm_per_unit is None and "mm_per_unit" in rows[0]:
        scale = np.array([[number(row, "mm_per_unit")] for row in rows])
    if np.any(np.asarray(scale) <= 0):
        raise InputError(f"mm_per_unit for {table} must be positive, got {np.min(scale):g}.")
    return transform_from_unity(values[:, :3] * scale, values[:, 3:], 1.0)


def _picture(folder: Path, row: Row) -> Path:
    name = row["image"]
    for path in (folder / "images" / name, folder / name):
        if name and is_file(path):
            return path
    raise InputError(f"{row.path}, line {row.line}: there is no picture {name!r} in {folder / 'images'} or {folder}.")
