"""``kidney=phantom``: a labeled collecting system from a seed."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.geodesic import ways_to
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.naming import name_calyces, with_poles
from ursnav_torch.kidney.phantom.implicit import plan_surface
from ursnav_torch.kidney.phantom.plan import draw_plan
from ursnav_torch.kidney.phantom.shapes import Cup, PhantomPlan
from ursnav_torch.kidney.tree import grow_tree, ridge_near

Array = NDArray[np.float64]

#: Fewest and most minor calyces, and how often each number is drawn.
_FEWEST, _MOST = 6, 14
_SHARES = (0.1, 0.22, 0.28, 0.16, 0.1, 0.06, 0.04, 0.02, 0.02)
#: Cups must stay this far from all that is not theirs, mm.
_GAP_MM = 0.7
#: A tip is the deepest place at least this far from the wall, mm.
_TIP_CLEARANCE_MM = 0.75
#: Tips nearer than this would be one calyx.
_TIPS_APART_MM = 5.0
_VOXEL_MM = 0.5
_PLANS, _MESHES = 2000, 10


def make_phantom_kidney(seed: int = 0, calyces: int | None = None, scale: float = 1.0) -> Kidney:
    """A right kidney drawn from a seed; the same seed gives the same kidney.

    Frame: x lateral, y anterior, z superior, the pelvis near the origin; calyces know their pole. The tip of a calyx
    is the deepest place of its fornix (the farthest from the pelvis along the lumen) that is 0.75 mm off the wall.

    Args:
        seed: a whole number from 0 on.
        calyces: number of minor calyces, 6 to 14; None draws it (8 or 7 most often).
        scale: 1.0 is anatomy, 1.8 the printed phantom of the thesis.

    Raises:
        InputError: a value is out of range.
    """
    if calyces is not None and not _FEWEST <= calyces <= _MOST:
        raise InputError(f"kidney.calyces must be a whole number from {_FEWEST} to {_MOST}, got {calyces}.")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"kidney.seed must be a whole number from 0 on, got {seed!r}.")
    if not np.isfinite(scale) or scale <= 0:
        raise InputError(f"kidney.scale must be a positive number, got {scale}.")
    rng = np.random.default_rng(int(seed))
    count = int(calyces or rng.choice(np.arange(_FEWEST, _MOST + 1), p=_SHARES))
    for _ in range(_MESHES):
        plan = _apart(rng, count)
        mesh = plan_surface(plan, rng)
        if mesh.is_watertight and mesh.euler_number == 2:
            kidney = _labeled(mesh, plan.cups, f"phantom, seed {seed}")
            if pdist(kidney.tips_mm).min() > _TIPS_APART_MM:
                return kidney.scaled(scale)
    raise InputError(f"Seed {seed} gives no lumen with {count} calyces that keep apart; take another seed.")


def _apart(rng: np.random.Generator, calyces: int) -> PhantomPlan:
    """The first plan drawn whose parts keep apart, or of many the one that does best."""
    best, gap = draw_plan(rng, calyces), -np.inf
    for _ in range(_PLANS):
        plan = draw_plan(rng, calyces)
        if plan.gap_mm() > gap:
            best, gap = plan, plan.gap_mm()
        if gap > _GAP_MM:
            break
    return best


def _labeled(mesh: trimesh.Trimesh, cups: tuple[Cup, ...], source: str) -> Kidney:
    grid = LumenGrid.from_mesh(mesh, _VOXEL_MM)
    pelvis = np.zeros(3)
    tips = _tips(grid, cups, pelvis)
    named = name_calyces(grow_tree(grid, pelvis, tips), tips)
    tree = grow_tree(grid, pelvis, np.array([c.tip_mm for c in named]))
    return Kidney(mesh, with_poles(named, (0.0, 0.0, 1.0)), tree, tree.points_mm[0], 1.0, source)


def _tips(grid: LumenGrid, cups: tuple[Cup, ...], pelvis_mm: Array) -> Array:
    """(C, 3) in every cup the voxel that is farthest from the pelvis along the lumen and not too near the wall."""
    way = ways_to(grid, np.array([ridge_near(grid, pelvis_mm)])).length_mm
    way[(grid.radius_mm < _TIP_CLEARANCE_MM) | ~np.isfinite(way)] = -1.0
    tips = []
    for cup in cups:
        local = cup.local(grid.centers_mm)
        inside = (local[:, 2] > 0) & (local[:, 2] < cup.depth_mm + 1.5)
        inside &= np.linalg.norm(local[:, :2] / (cup.radii_mm + 1.0), axis=1) < 1
        tips.append(grid.centers_mm[np.where(inside, way, -1.0).argmax()])
    return np.array(tips)
