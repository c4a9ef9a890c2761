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
#: Others that NRRD knows, which say nothing of a patient.
_OTHER_SPACES = {
    "scanner-xyz", "scanner-xyz-time", "3d-right-handed", "3d-left-handed", "3d-right-handed-time",
    "3d-left-handed-time",
}  # fmt: skip


def nrrd_said(path: Path) -> Said:
    """What an NRRD header says.

    Raises:
        InputError: it is no such header, or holds a number that cannot be.
    """
    fields = header_fields(path, ":", b"NRRD")
    directions = _vectors(fields.get("space directions", ""))
    spacings = header_numbers(fields.get("spacings", ""))
    _check_space(fields, bool(len(directions)), path)
    spacing = len(directions) >= 3 or int(np.sum(spacings > 0)) >= 3
    orientation = len(directions) >= 3 and fields.get("space", "").lower() in _PATIENT_SPACES
    placed = len(_vectors(fields.get("space origin", ""), least=0)) == 1
    notes = () if not orientation or placed else (_no_origin(path),)
    words = {w.lower() for w in re.findall(r'"([^"]*)"', fields.get("space units", fields.get("units", "")))} - {""}
    said = next((f"{key} is {fields[key]}" for key in ("space directions", "spacings") if key in fields), "")
    return Said(spacing, orientation, _unit(words, path), 1.0, notes, found=said)


def _check_space(fields: dict[str, str], directed: bool, path: Path) -> None:
    """Refuse a space that NRRD does not have, or distances in one that says no directions.

    Raises:
        InputError: see there.
    """
    space = fields.get("space", "").lower()
    if space and space not in _PATIENT_SPACES | _OTHER_SPACES:
        raise InputError(
            f"{path} states its space as {fields['space']!r}, which NRRD has not: left-posterior-superior, "
            "right-anterior-superior or left-anterior-superior is expected. Export it again, or write one of them with "
            "the directions that go with it."
        )
    if space and not directed and "spacings" in fields:
        raise InputError(
            f"{path} states a space and spacings, and no space directions: how it lies in that space is not said. "
            "Export it again, or delete the line space and say kidney.header.orientation=."
        )


def meta_said(path: Path) -> Said:
    """What the header of a MetaImage says.

    Raises:
        InputError: as `nrrd_said` does.
    """
    fields = header_fields(path, "=", b"")
    if any(name.startswith("seq_frame") for name in fields):
        raise InputError(
            f"{path} is a sequence that Plus recorded, pictures and poses over time (Seq_Frame...), and no scan. Give "
            "the volume that was reconstructed of it, or the CT."
        )
    sizes = header_numbers(fields.get("elementspacing", fields.get("elementsize", "")))
    matrix = next((fields[key] for key in ("transformmatrix", "rotation", "orientation") if key in fields), None)
    named = fields.get("anatomicalorientation", "").upper()
    offset = next((fields[key] for key in ("offset", "position", "origin") if key in fields), "nan")
    placed = "nan" not in offset.lower()
    lies = matrix is not None or named == _AS_IT_IS  # a reader goes by the matrix alone, and without one by this
    notes = [_no_origin(path)] if lies and not placed else []
    if (
        matrix is not None
        and re.fullmatch("[RLAPSI]{3}", named)
        and named != (told := _from_sides(header_numbers(matrix)))
    ):
        notes.append(f"{path.name} tells two orientations: {named} by name and {told} by its matrix, which is used")
    unit = fields.get("distanceunits", "").lower().strip("?\"' ")
    return Said(int(np.sum(sizes > 0)) >= 3, lies, _unit({unit} - {""}, path), 1.0, tuple(notes))


def _from_sides(matrix: np.ndarray) -> str:
    """MetaImage's letters, the sides that the voxel axes begin at, of nine direction cosines in LPS, axis by axis."""
    if matrix.size != 9:
        return ""
    axes = matrix.reshape(3, 3)
    return "".join("RL AP IS".split()[i][int(axis[i] < 0)] for axis in axes for i in [int(np.abs(axis).argmax())])


def header_fields(path: Path, sign: str, magic: bytes) -> dict[str, str]:
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


def header_numbers(text: str) -> np.ndarray:
    """The numbers of a text, 0 for those that are not finite; none where a word is no number."""
    return np.nan_to_num(_words(text), posinf=0.0, neginf=0.0)


def _words(text: str) -> np.ndarray:
    try:
        return np.array([float(word) for word in text.split()])
    except ValueError:
        return np.zeros(0)


def _vectors(text: str, least: float = 1e-12) -> list[np.ndarray]:
    """The vectors in brackets that are numbers, and longer than ``least`` or as long."""
    found = [_words(inner.replace(",", " ")) for inner in re.findall(r"\(([^)]*)\)", text)]
    return [v for v in found if v.size and np.isfinite(v).all() and np.linalg.norm(v) >= least]


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
