"""The scope in a phantom: a calyx that a stone closes, plays, and what an operation does besides."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.flights import Case
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, severity, simulate
from ursnav_torch.simulation import Scope, SimulatedTime, Tissue, TissueSettings, Twin, World
from ursnav_torch.simulation.world import swelling_renderer
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: What an operation does, by the field of `TissueSettings` that switches it.
DISTURBANCES = {"breathing": "breathes", "swelling": "swells", "bleeding": "bleeds", "buckling": "buckles"}
#: The stone lies so far before the tip of its calyx, or as far as the calyx's own branch goes, mm.
STONE_MM = 9.0


def twin_in(
    case: Case, vid: Vid, rng: np.random.Generator, clock: SimulatedTime, stone: Array, on: TissueSettings
) -> Twin:
    """The scope at the beginning.

    Args:
        case: the phantom, and the kind of its pictures.
        vid: its kidney and lens.
        rng: draws plays, faults and roll.
        clock: by which the kidney breathes, swells and bleeds.
        stone: x, y, z and radius of the stone, which the map does not know.
        on: what an operation does.
    """
    kidney, lumen = vid.kidney, vid.lumen
    scope = Scope(backlash=(*rng.uniform(0.05, 0.15, 2), rng.uniform(0.2, 1.0)), compression_mm=2.0)
    faults = severity(PRESETS[case.kind], 0.2, rng)
    drawn = np.random.default_rng([case.seed, 22])
    tissue = Tissue(on, np.random.default_rng([case.seed, 23]), kidney.scale)
    walls = tissue.clearance(lumen.clearance_mm, clock)
    world = World(kidney, RaycastRenderer(kidney.mesh, vid.camera), redraw=lambda m: RaycastRenderer(m, vid.camera))
    renderer = swelling_renderer(world, tissue, clock)
    start = kidney.centerline.points_mm[0]
    return Twin(
        lambda p: np.minimum(walls(p), np.linalg.norm(p - stone[:3], axis=1) - stone[3]),
        lambda T: tissue.picture(simulate(renderer(), T, faults, drawn), clock()),
        look_along(start, kidney.tips_mm.mean(axis=0) - start, float(rng.uniform(-np.pi, np.pi))),
        replace(scope, friction=tissue.friction),
        breathing=lambda: tissue.breath_mm(clock()),
    )


def tissue_of(named: str) -> TissueSettings:
    """What is switched on, of `DISTURBANCES`, by names with commas between.

    Raises:
        InputError: there is no such one.
    """
    wanted = {name.strip() for name in named.split(",") if name.strip()}
    if not wanted <= set(DISTURBANCES):
        raise InputError(f"tissue= takes {', '.join(DISTURBANCES)}, got {named!r}.")
    return TissueSettings(**{field: name in wanted for name, field in DISTURBANCES.items()})


def stone_in(vid: Vid, rng: np.random.Generator) -> tuple[Array, int]:
    """A stone (x, y, z, radius) that closes the own branch of a calyx, and which calyx."""
    tree = vid.kidney.centerline
    calyx = int(rng.integers(len(vid.kidney.calyces)))
    path = tree.path_to(calyx)
    own = path[tree.calyx[path] == calyx]
    to_tip = tree.from_root_mm()[own[-1]] - tree.from_root_mm()[own]
    at = own[int(np.abs(to_tip - STONE_MM).argmin())]
    return np.array([*tree.points_mm[at], tree.radius_mm[at] + 0.2]), calyx
