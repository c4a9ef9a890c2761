"""``kidney=mesh``: the collecting system from a surface file."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.build import build_kidney
from ursnav_torch.kidney.checks import check_lumen
from ursnav_torch.kidney.tables import check_given, read_calyces

_FORMATS = (".stl", ".ply", ".obj", ".glb")
#: Bytes of a binary STL file before its triangles, and of each of them.
_STL_HEAD, _STL_TRIANGLE = 84, 50
#: A corner with decimal commas in an ASCII STL, an OBJ or an ASCII PLY.
_DECIMAL_COMMA = re.compile(rb"(^|\n)\s*(vertex\s+|v\s+|)[+-]?\d+,\d+\s+[+-]?\d+,\d+\s")
#: How files begin that are none, whatever their name: a page of the web, a pointer of Git LFS.
_NO_FILES = {b"<": "a page of the web", b"version https://git-lfs": "a pointer of Git LFS and not the file itself"}


def load_mesh_kidney(
    path: Path | str,
    calyces: Path | str | None = None,
    scale: float = 1.0,
    superior: ArrayLike | None = None,
    calyces_unit: str | None = None,
) -> Kidney:
    """A kidney from a file of its lumen: STL (binary or ASCII), PLY, OBJ or GLB, in mm.

    Args:
        path: the mesh.
        calyces: CSV `calyx,x_mm,y_mm,z_mm` with the tip of each minor calyx in the file's own coordinates, and
            perhaps a row `pelvis`; None finds and names them.
        scale: everything is multiplied by it; the kidney frame is the scaled one. Beyond what turns the file's
            unit into mm it is the kidney's ``scale`` (see `enlargement`).
        superior: direction (3,) towards the head, kidney frame; names the poles.
        calyces_unit: of the lengths in ``calyces``, where the columns do not say it, or say it wrong.

    Raises:
        InputError: the files cannot be read or are not what they should be (see `check_lumen`).
    """
    larger = enlargement(scale)
    mesh = read_mesh(path)
    mesh.apply_scale(scale)
    name = Path(path).name
    mesh = check_lumen(mesh, name, larger)
    given, pelvis = read_calyces(calyces, calyces_unit) if calyces is not None else (None, None)
    if given is not None:
        if calyces_unit is None:
            check_given(given, mesh.bounds / scale, str(calyces))
        given = tuple(replace(c, tip_mm=c.tip_mm * scale) for c in given)
    return build_kidney(mesh, name, larger, given, None if pelvis is None else pelvis * scale, superior)


def enlargement(scale: float) -> float:
    """How many times larger than anatomy a kidney is whose file was multiplied by ``scale``.

    A factor of 10 or 1000 in it only turns centimeters or meters into mm, and one below 1 brings an enlarged model
    back to anatomy: 1.8 -> 1.8, 1000 -> 1, 1800 -> 1.8, 0.5556 -> 1.

    Raises:
        InputError: the factor is none of these.
    """
    for unit in (1.0, 10.0, 1000.0):
        if 0.1 <= scale / unit <= 5.0:
            return max(scale / unit, 1.0)
    raise InputError(
        f"kidney.scale is {scale}; accepted are 0.1 to 5 for a file in mm, and 10 or 1000 times that for one in "
        "centimeters or meters."
    )


def read_mesh(path: Path | str) -> trimesh.Trimesh:
    """The triangles of an STL, PLY, OBJ or GLB file, all its parts joined.

    Raises:
        InputError: the file is missing, empty, of another kind or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no mesh file {path}. Check kidney.path.")
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"{path} is no mesh format that can be read; accepted: {', '.join(_FORMATS)}.")
    if path.stat().st_size == 0:
        raise InputError(f"{path} is empty (0 bytes); export or copy it again.")
    try:
        mesh = _load(path)
    except InputError:
        raise
    except Exception as error:  # the readers raise whatever a damaged file makes them stumble over
        raise InputError(f"{path} cannot be read as {path.suffix[1:].upper()}: {error}. Export it again.") from error
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1:] != (3,) or (len(faces) and faces.shape[1] != 3):
        raise InputError(f"{path} holds no triangles with corners in space; export the lumen as a triangle mesh.")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        wrong = int(faces.max() if faces.max() >= len(vertices) else faces.min())
        raise InputError(
            f"{path} is damaged: a triangle names corner {wrong}, and the file has {len(vertices)}. Export it again."
        )
    return trimesh.Trimesh(vertices, faces, process=False)


def _load(path: Path) -> trimesh.Trimesh:
    _check_kind(path)
    data = path.read_bytes() if path.suffix.lower() == ".stl" else b""
    if len(data) >= _STL_HEAD:
        length = _STL_HEAD + _STL_TRIANGLE * int.from_bytes(data[80:84], "little")
        if _STL_HEAD < length < len(data) and not _is_text(data):
            # programs put colors or names behind the triangles; the reader would take the file for text
            return trimesh.load_mesh(io.BytesIO(data[:length]), file_type="stl", process=False)
        if length > len(data) and not _is_text(data):
            raise InputError(
                f"{path} ends before its data do: its header counts {(length - _STL_HEAD) // _STL_TRIANGLE} triangles, "
                f"and it holds {(len(data) - _STL_HEAD) // _STL_TRIANGLE}. Copy or export it again."
            )
    if _is_text(data):
        _check_text(data, path)
    return trimesh.load_scene(path, process=False).to_mesh()


def _check_kind(path: Path) -> None:
    """Refuse what its first bytes say is another kind of file, and decimal commas.

    Raises:
        InputError: it is, or has them.
    """
    with path.open("rb") as file:
        head, kind = file.read(8192), path.suffix[1:].upper()
    other = next((what for start, what in _NO_FILES.items() if head.lstrip().startswith(start)), None)
    if other is None and kind == "OBJ" and b"\0" in head:
        other = "no text"
    if other is None and kind == "STL" and len(head) > 80 and b"\0" not in head and not _is_text(head):
        other = "text without the word solid"
    if other is not None:
        raise InputError(f"{path} is {other}, and no {kind}; export or copy the mesh again.")
    if kind == "PLY" and b"format ascii" in head:
        _check_ascii_ply(path.read_bytes(), path)
    if b"\0" not in head and _DECIMAL_COMMA.search(head):
        raise InputError(f"{path} has decimal commas; export it with decimal points, or as binary STL.")


def _check_ascii_ply(data: bytes, path: Path) -> None:
    """Refuse an ASCII PLY of fewer lines than its header counts: its reader leaves out what is missing."""
    head, _, body = data.partition(b"end_header")
    counted = sum(int(count) for count in re.findall(rb"element \w+ (\d{1,9})\s", head))
    if (there := len(body.split(b"\n")) - 1 - body.endswith(b"\n")) < counted:
        raise InputError(
            f"{path} ends before its data do: its header counts {counted} lines, and it holds {there}. Copy or export "
            "it again."
        )


def _check_text(data: bytes, path: Path) -> None:
    """Refuse an ASCII STL that ends early, of which the reader would say nothing.

    Raises:
        InputError: it does.
    """
    if b"endsolid" not in data[-4096:].lower():
        raise InputError(f"{path} is cut short: the word endsolid is missing at its end. Copy or export it again.")


def _is_text(data: bytes) -> bool:
    """Whether an STL file is ASCII: it begins with ``solid`` and goes on with facets, and is no binary one's length."""
    counted = _STL_HEAD + _STL_TRIANGLE * int.from_bytes(data[80:84], "little")
    return data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower() and len(data) != counted
