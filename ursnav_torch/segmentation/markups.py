"""3D Slicer's markups (.mrk.json): points for calyces and landmarks, curves for a centerline."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import T_RAS_LPS, apply
from ursnav_torch.kidney.anatomy import Calyx
from ursnav_torch.records import read_json

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Markup:
    """One list of points or one curve.

    Attributes:
        kind: Slicer's type: "Fiducial", "Curve", ...
        names: label of each control point; "" without one.
        points_lps: (N, 3) control points, LPS, mm.
    """

    kind: str
    names: tuple[str, ...]
    points_lps: Array


def read_markups(path: Path | str) -> tuple[Markup, ...]:
    """The markups of a file; RAS files are turned to LPS, points without a defined place are left out.

    Raises:
        InputError: missing, not such a file, in units other than mm, or without a point; see `_markup`.
    """
    try:
        data = read_json(Path(path), "markups")
        markups = tuple(_markup(m, Path(path)) for m in data["markups"])
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path} is not a markups file of 3D Slicer: it needs a list markups, each with controlPoints, whose "
            "position is three numbers. Save it again there."
        ) from None
    if not any(len(m.points_lps) for m in markups):
        raise InputError(f"{path} holds no point; place the points in 3D Slicer and save them again.")
    return markups


def _markup(data: dict[str, Any], path: Path) -> Markup:
    """One markup; its coordinate system and unit are those of the format's definition where it says none, said so."""
    if data["controlPoints"] and (unsaid := [k for k in ("coordinateSystem", "coordinateUnits") if k not in data]):
        warnings.warn(
            f"{path} does not say its {' and '.join(unsaid)}: by the format's definition LPS and mm are taken.",
            stacklevel=3,
        )
    system, units = str(data.get("coordinateSystem", "LPS")).upper(), data.get("coordinateUnits", "mm")
    if system not in ("LPS", "0", "RAS", "1") or not _in_mm(units):
        raise InputError(
            f"The markups in {path} are in {system} and {units}, which are not understood; save them in LPS or RAS and "
            "mm."
        )
    points = [p for p in data["controlPoints"] if p.get("positionStatus", "defined") == "defined"]
    at = np.array([p["position"] for p in points], float).reshape(-1, 3)
    if len(wrong := np.flatnonzero(~np.isfinite(at).all(axis=1))):
        raise InputError(
            f"{path}: control point {wrong[0] + 1} is at {at[wrong[0]].tolist()}, which is no place; place it again in "
            "3D Slicer."
        )
    if system in ("RAS", "0"):  # Slicer's old files number them: 0 is RAS, 1 is LPS
        at = apply(T_RAS_LPS, at)
    return Markup(str(data.get("type", "Fiducial")), tuple(str(p.get("label", "")) for p in points), at)


def _in_mm(units: Any) -> bool:
    """``mm``, or its code in UCUM as the schema allows it: ``["mm", "UCUM", "millimeter"]``."""
    return bool(units == "mm" or (isinstance(units, list) and [str(u) for u in units[:2]] == ["mm", "UCUM"]))


def points_of(markups: Sequence[Markup]) -> tuple[tuple[str, ...], Array]:
    """Names and points (N, 3), LPS, of all point lists."""
    lists = [m for m in markups if m.kind in ("Fiducial", "PointList")]
    names = tuple(name for m in lists for name in m.names)
    return names, np.concatenate([m.points_lps for m in lists]) if lists else np.zeros((0, 3))


def curves_of(markups: Sequence[Markup]) -> tuple[Array, ...]:
    """Points (N, 3), LPS, of every curve with at least two."""
    return tuple(m.points_lps for m in markups if m.kind in ("Curve", "Line") and len(m.points_lps) >= 2)


def calyces_from_markups(
    markups: Sequence[Markup], T_kidney_lps: Array, source: str
) -> tuple[tuple[Calyx, ...], Array | None]:
    """Calyces named as the points are, in the kidney frame, and the point named ``pelvis`` (3,) if there is one.

    Raises:
        InputError: no point, or a name that is empty or used twice.
    """
    names, points = points_of(markups)
    points = apply(T_kidney_lps, points) if len(points) else points
    for name in names:
        if not name.strip() or names.count(name) > 1:
            raise InputError(
                f"{source}: the point name {name!r} is {'used twice' if name.strip() else 'empty'}; name each calyx "
                "once."
            )
    pelvis = next((p for n, p in zip(names, points, strict=True) if n.strip().lower() == "pelvis"), None)
    calyces = tuple(Calyx(n.strip(), p) for n, p in zip(names, points, strict=True) if n.strip().lower() != "pelvis")
    if not calyces:
        raise InputError(f"{source} names no calyx; place a point list with a point in every calyx.")
    return calyces, pelvis
