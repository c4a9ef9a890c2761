"""3D Slicer: points and curves as markups (.mrk.json), a registration as an ITK transform (.tfm)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_file, write_json
from ursnav_torch.geometry import T_RAS_LPS, Array, apply
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import Markup

#: What Slicer looks for to know the format.
_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
#: Control points of a path lie at least so far apart, mm: thousands of them would make Slicer slow.
_POINT_STEP_MM = 0.5


def write_markups(path: Path, markups: Sequence[Markup], overwrite: bool = True) -> None:
    """Write points and curves as 3D Slicer's .mrk.json, in LPS and mm as the file itself says; whole or not at all."""
    plain = [_plain(markup) for markup in markups]
    write_json(path, {"@schema": _SCHEMA, "markups": plain}, overwrite)


def point_markup(names: Sequence[str], points_kidney: Array, T_lps_kidney: Array) -> Markup:
    """A point list of named points (N, 3), kidney frame, mm; ``T_lps_kidney`` (4, 4)."""
    return Markup("Fiducial", tuple(names), apply(T_lps_kidney, points_kidney))


def calyx_markup(kidney: Kidney, T_lps_kidney: Array) -> Markup:
    """The tips of the calyces and the pelvis as a point list that ``kidney.calyces=`` takes back; (4, 4) transform."""
    names = ["pelvis", *(c.name for c in kidney.calyces)]
    return point_markup(names, np.vstack([kidney.pelvis_mm, kidney.tips_mm]), T_lps_kidney)


def path_markups(T_kidney_camera: Array, T_lps_kidney: Array) -> tuple[Markup, ...]:
    """Where the scope's tip was, a curve for every stretch without a gap.

    Args:
        T_kidney_camera: (N, 4, 4), nan where there is none.
        T_lps_kidney: (4, 4).

    Raises:
        InputError: there are no two poses in a row.
    """
    T = np.asarray(T_kidney_camera, float)
    known = np.isfinite(T).all((1, 2))
    ends = np.flatnonzero(np.diff(np.concatenate([[0], known, [0]])))
    curves = [_thinned(T[a:b, :3, 3]) for a, b in zip(ends[::2], ends[1::2], strict=True) if b - a > 1]
    if not curves:
        raise InputError("The track has no two poses in a row, so that there is no path to be shown.")
    return tuple(Markup("Curve", ("",) * len(c), apply(T_lps_kidney, c)) for c in curves)


def write_tfm(path: Path, T_kidney_em: Array, T_lps_kidney: Array, overwrite: bool = True) -> None:
    """Write a registration (4, 4) as ITK's text transform, of which 3D Slicer makes the node that moves EM poses.

    ITK's files hold the *resampling* direction, from the space that results to the one that is given, in LPS: here
    from the patient to the EM frame. Slicer inverts what it reads, and its node ("to parent") then takes poses from
    the tracker, whose plain numbers it holds for RAS as it does all that comes by OpenIGTLink, to the patient.

    Args:
        path: the file.
        T_kidney_em: (4, 4), with a scale perhaps.
        T_lps_kidney: (4, 4).
        overwrite: replace what stands there.
    """
    T_lps_lpsem = np.asarray(T_lps_kidney, float) @ np.asarray(T_kidney_em, float) @ T_RAS_LPS
    held = np.linalg.inv(T_lps_lpsem)
    numbers = " ".join(f"{v:.12g}" for v in (*held[:3, :3].ravel(), *held[:3, 3]))
    lines = ["#Insight Transform File V1.0", "#Transform 0", "Transform: AffineTransform_double_3_3",
             f"Parameters: {numbers}", "FixedParameters: 0 0 0"]  # fmt: skip
    with whole_file(path, overwrite) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="ascii")


def _thinned(points: Array) -> Array:
    """Every point that lies far enough from the one kept before, and the last."""
    kept = [0]
    for i in range(1, len(points)):
        if np.linalg.norm(points[i] - points[kept[-1]]) >= _POINT_STEP_MM:
            kept.append(i)
    return points[kept if kept[-1] == len(points) - 1 else [*kept, len(points) - 1]]


def _plain(markup: Markup) -> dict[str, Any]:
    points = [
        {"id": str(i + 1), "label": name, "position": point, "selected": True, "locked": False, "visibility": True,
         "positionStatus": "defined"}
        for i, (name, point) in enumerate(zip(markup.names, markup.points_lps.round(6).tolist(), strict=True))
    ]  # fmt: skip
    return {"type": markup.kind, "coordinateSystem": "LPS", "coordinateUnits": "mm", "locked": True,
            "labelFormat": "%N-%d", "controlPoints": points}  # fmt: skip
