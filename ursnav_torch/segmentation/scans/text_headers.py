"""The headers of NRRD and MetaImage files, which are text: what they say of the geometry."""

import re
from pathlib import Path

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation.scans.headers import UNITS_MM, Said

#: A header longer than this, or a number with more digits, is none: the readers behind crash on such.
_LONGEST_HEADER, _LONGEST_NUMBER = 1 << 20, 60
#: MetaImage's letters for axes that rise to the left, posterior and superior.
_AS_IT_IS = "RAI"
_PATIENT_SPACES = {
    "left-posterior-superior", "lps", "right-anterior-superior", "ras", "left-anterior-superior", "las",
    "left-posterior-superior-time", "right-anterior-superior-time", "left-anterior-superior-time",
    "lpst", "rast", "last",
}  # fmt: skip


def nrrd_said(path: Path) -> Said:
    """What an NRRD header says.

    Raises:
        InputError: it is no such header, or holds a number that cannot be.
    """
    fields = _fields(path, ":", b"NRRD")
    directions = _vectors(fields.get("space directions", ""))
    spacings = _numbers(fields.get("spacings", ""))
    spacing = len(directions) >= 3 or int(np.sum(spacings > 0)) >= 3
    orientation = len(directions) >= 3 and fields.get("space", "").lower() in _PATIENT_SPACES
    notes = () if not orientation or "space origin" in fields else (_no_origin(path),)
    words = {w.lower() for w in re.findall(r'"([^"]*)"', fields.get("space units", fields.get("units", "")))} - {""}
    return Said(spacing, orientation, _unit(words, path), 1.0, notes)


def meta_said(path: Path) -> Said:
    """What the header of a MetaImage says.

    Raises:
        InputError: as `nrrd_said` does.
    """
    fields = _fields(path, "=", b"")
    sizes = _numbers(fields.get("elementspacing", fields.get("elementsize", "")))
    matrix = next((fields[key] for key in ("transformmatrix", "rotation", "orientation") if key in fields), None)
    named = fields.get("anatomicalorientation", "").upper()
    placed = any(key in fields for key in ("offset", "position", "origin"))
    lies = matrix is not None or named == _AS_IT_IS  # a reader goes by the matrix alone, and without one by this
    notes = [_no_origin(path)] if lies and not placed else []
    if matrix is not None and re.fullmatch("[RLAPSI]{3}", named) and named != (told := _from_sides(_numbers(matrix))):
        notes.append(f"{path.name} tells two orientations: {named} by name and {told} by its matrix, which is used")
    unit = fields.get("distanceunits", "").lower().strip("?\"' ")
    return Said(int(np.sum(sizes > 0)) >= 3, lies, _unit({unit} - {""}, path), 1.0, tuple(notes))


def _from_sides(matrix: np.ndarray) -> str:
    """MetaImage's letters, the sides that the voxel axes begin at, of nine direction cosines in LPS, axis by axis."""
    if matrix.size != 9:
        return ""
    axes = matrix.reshape(3, 3)
    return "".join("RL AP IS".split()[i][int(axis[i] < 0)] for axis in axes for i in [int(np.abs(axis).argmax())])


def _fields(path: Path, sign: str, magic: bytes) -> dict[str, str]:
    """Fields by their small names, up to the blank line (NRRD) or the data's name (MetaImage)."""
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    if not head.startswith(magic):
        raise InputError(f"{path} cannot be read as a scan: it has no NRRD header. Export or copy it again.")
    fields: dict[str, str] = {}
    for raw in head.split(b"\n"):
        line = raw.decode("latin1").strip()
        if not line and magic:
            break
        name, found, value = line.partition(sign)
        if not found or line.startswith("#"):
            continue
        if longest := re.search(rf"[\d.]{{{_LONGEST_NUMBER},}}", value[:100_000]):
            raise InputError(
                f"{path} cannot be read as a scan: {name.strip()} in its header holds a number of "
                f"{len(longest.group())} digits. Export or copy it again."
            )
        fields.setdefault(name.strip().lower(), value.lstrip("=").strip())
        if name.strip().lower() == "elementdatafile":
            break
    return fields


def _numbers(text: str) -> np.ndarray:
    try:
        return np.nan_to_num(np.array([float(word) for word in text.split()]), posinf=0.0, neginf=0.0)
    except ValueError:
        return np.zeros(0)


def _vectors(text: str) -> list[str]:
    return re.findall(r"\(([^)]*)\)", text)


def _unit(words: set[str], path: Path) -> float | None:
    if not words:
        return None
    if len(words) > 1 or not words <= set(UNITS_MM):
        raise InputError(
            f"{path} states its unit as {', '.join(sorted(words))}, which is not understood: say "
            "kidney.header.unit=mm, cm, m or um, or export it again in mm."
        )
    return UNITS_MM[words.pop()]


def _no_origin(path: Path) -> str:
    return f"{path.name} does not say where in the patient it lies; its first voxel is taken for the origin"
