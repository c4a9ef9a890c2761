"""``kidney=mesh``: the collecting system from a surface file."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Calyx, Kidney
from ursnav_torch.kidney.build import build_kidney
from ursnav_torch.kidney.checks import check_lumen
from ursnav_torch.kidney.tables import read_calyces

_FORMATS = (".stl", ".ply", ".obj", ".glb")


def load_mesh_kidney(
    path: Path | str,
    calyces: Path | str | None = None,
    scale: float = 1.0,
    superior: ArrayLike | None = None,
) -> Kidney:
    """A kidney from a file of its lumen: STL (binary or ASCII), PLY, OBJ or GLB, in mm.

    Args:
        path: the mesh.
        calyces: CSV `calyx,x_mm,y_mm,z_mm` with the tip of each minor calyx in the file's own coordinates, and
            perhaps a row `pelvis`; None finds and names them.
        scale: everything is multiplied by it; the kidney frame is the scaled one.
        superior: direction (3,) towards the head, kidney frame; names the poles.

    Raises:
        InputError: the files cannot be read or are not what they should be (see `check_lumen`).
    """
    if not np.isfinite(scale) or scale <= 0:
        raise InputError(f"kidney.scale must be a positive number, got {scale}.")
    mesh = read_mesh(path)
    mesh.apply_scale(scale)
    name = Path(path).name
    mesh = check_lumen(mesh, name, scale)
    given, pelvis = read_calyces(calyces) if calyces is not None else (None, None)
    if given is not None:
        given = tuple(Calyx(c.name, c.tip_mm * scale, c.pole) for c in given)
    return build_kidney(
        mesh,
        name,
        scale,
        given,
        None if pelvis is None else pelvis * scale,
        None if superior is None else np.asarray(superior, float),
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
        mesh = trimesh.load_scene(path, process=False).to_mesh()
    except Exception as error:  # the readers raise whatever a damaged file makes them stumble over
        raise InputError(f"{path} cannot be read as {path.suffix[1:].upper()}: {error}. Export it again.") from error
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
