"""Distances along the lumen on disk: found once, when the VID is built, and read in a blink ever after."""

from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.kidney.grid import VoxelGrid


def save_lumen(path: Path, lumen: LumenDistance) -> None:
    """Write distances along the lumen as safetensors, readable by whom the umask lets read."""
    grid = lumen.grid
    path.touch()
    mode = path.stat().st_mode
    arrays = {
        "wall_mm": grid.wall_mm.astype(np.float32),
        "inside": grid.index >= 0,
        "origin_mm": grid.origin_mm.astype(np.float64),
        "voxel_mm": np.array([grid.voxel_mm]),
        "corner": lumen.corner,
        "beyond_mm": lumen.beyond_mm,
    }
    save_file({name: np.ascontiguousarray(a) for name, a in arrays.items()}, str(path))
    path.chmod(mode)


def load_lumen(path: Path, kidney: Kidney) -> LumenDistance:
    """Read `save_lumen`'s file of a kidney.

    Raises:
        InputError: damaged, or not of this kidney.
    """
    try:
        a = load_file(str(path))
        inside, corner, beyond = a["inside"], a["corner"], a["beyond_mm"]
        wall, origin, voxel = a["wall_mm"].astype(float), a["origin_mm"], float(a["voxel_mm"][0])
    except (SafetensorError, KeyError, IndexError, OSError) as error:
        raise InputError(f"{path} is damaged ({error}); copy it again or build the VID again.") from None
    rows = (len(kidney.calyces), int(inside.sum()))
    if wall.shape != inside.shape or corner.shape != rows or beyond.shape != rows or corner.max(initial=0) >= rows[1]:
        raise InputError(
            f"{path}: distances {corner.shape} and {beyond.shape} do not fit {rows[0]} calyces and {rows[1]} voxels; "
            "build the VID again."
        )
    grid = VoxelGrid.from_inside(inside.astype(bool), wall, origin, voxel)
    return LumenDistance(grid, kidney.tips_mm, corner, beyond, kidney.scale)
