"""``kidney=phantom``: a procedural collecting system from a seed."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.naming import name_calyces, with_poles
from ursnav_torch.kidney.phantom_plan import Cup, draw_plan
from ursnav_torch.kidney.phantom_surface import plan_surface
from ursnav_torch.kidney.tree import grow_tree

Array = NDArray[np.float64]

#: Fewest and most minor calyces that a phantom may have.
CALYCES = (6, 14)
#: A tip is the deepest place at least this far from the wall, mm.
_TIP_CLEARANCE_MM = 0.75
_ATTEMPTS = 40


def make_phantom_kidney(seed: int = 0, calyces: int | None = None, scale: float = 1.0) -> Kidney:
    """A right kidney drawn from a seed; the same seed gives the same kidney.

    Frame: x lateral, y anterior, z superior, the pelvis near the origin. The tip of a calyx is the deepest place in
    its fornix (the farthest from the pelvis along the lumen) that is 0.75 mm from the wall.

    Args:
        seed: any whole number from 0 on.
        calyces: number of minor calyces, 6 to 14; None draws it (7 or 8 most often).
        scale: 1.0 is anatomy, 1.8 the printed phantom of the thesis.

    Raises:
        InputError: a value is out of range.
    """
    low, high = CALYCES
    if calyces is not None and not low <= calyces <= high:
        raise InputError(f"kidney.calyces must be a whole number from {low} to {high}, got {calyces}.")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"kidney.seed must be a whole number from 0 on, got {seed!r}.")
    if not np.isfinite(scale) or scale <= 0:
        raise InputError(f"kidney.scale must be a positive number, got {scale}.")
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([int(seed), attempt])
        count = calyces or int(rng.choice(np.arange(low, high + 1), p=_SHARES))
        plan = draw_plan(rng, count)
        mesh = plan_surface(plan, rng)
        if mesh.is_watertight and mesh.euler_number == 2 and mesh.body_count == 1:
            return _kidney(mesh, plan.cups, scale, f"phantom, seed {seed}")
    raise InputError(f"Seed {seed} with {calyces} calyces gives no lumen without touching branches; take another seed.")


#: How often 6, 7, ... 14 minor calyces are drawn.
_SHARES = np.array([0.1, 0.22, 0.28, 0.16, 0.1, 0.06, 0.04, 0.02, 0.02])


def _kidney(mesh: trimesh.Trimesh, cups: tuple[Cup, ...], scale: float, source: str) -> Kidney:
    grid = LumenGrid.from_mesh(mesh, 0.5)
    tips = _tips(grid, cups)
    named = with_poles(name_calyces(grow_tree(grid, np.zeros(3), tips), tips), np.array([0.0, 0.0, 1.0]))
    tree = grow_tree(grid, np.zeros(3), np.array([c.tip_mm for c in named]))
    return Kidney(mesh, named, tree, tree.points_mm[0], 1.0, source).scaled(scale)


def _tips(grid: LumenGrid, cups: tuple[Cup, ...]) -> Array:
    """(C, 3) in every cup the voxel that is farthest from the pelvis along the lumen and not too near the wall."""
    along = dijkstra(grid.graph(), indices=grid.nearest(np.zeros(3))[0])
    along[grid.radius_mm < _TIP_CLEARANCE_MM] = -np.inf
    tips = []
    for cup in cups:
        local = (grid.centers_mm - cup.base_mm) @ cup.axes.T
        inside = (local[:, 2] > 0) & (np.linalg.norm(local[:, :2] / (cup.radii_mm + 0.5), axis=1) < 1)
        inside &= local[:, 2] < cup.depth_mm + 1
        tips.append(grid.centers_mm[np.where(inside, along, -np.inf).argmax()])
    return np.array(tips)
