"""The scope in a phantom: a calyx that a stone closes, plays, and what an operation does besides."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.flights import Case, phantom_of, vid_for
from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, Stone, severity, simulate_labeled
from ursnav_torch.simulation import Scope, SimulatedTime, Tissue, TissueSettings, Twin, World
from ursnav_torch.simulation.world import swelling_renderer
from ursnav_torch.vid import PlanSettings, Vid
from ursnav_torch.vid.plan import plan_views

Array = NDArray[np.float64]

#: What an operation does, by the field of `TissueSettings` that switches it.
DISTURBANCES = {"breathing": "breathes", "swelling": "swells", "bleeding": "bleeds", "buckling": "buckles"}
#: The stone lies so far before the tip of its calyx, or as far as the calyx's own branch goes, mm.
STONE_MM = 9.0
#: Its reflectance, pale and yellow, and its roughness.
_STONE_BGR, _STONE_BUMPS = (0.55, 0.75, 0.85), 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Anatomy:
    """What an exploration knows of a kidney before it; a VID's, without its pictures.

    Attributes:
        kidney, lumen, camera: of it.
        T_kidney_camera: (V, 4, 4) poses that a scope can take.
        vid: with the pictures; None where none is needed.
    """

    kidney: Kidney
    lumen: LumenDistance
    camera: Camera
    T_kidney_camera: Array
    vid: Vid | None = None


def anatomy_of(case: Case, views: int, around: float, work: Path, drawn: bool) -> Anatomy:
    """A case's kidney with as many views a calyx and around; ``drawn``: with a VID, which is built once."""
    if drawn:
        vid = vid_for(case, views, around, work, None)
        return Anatomy(vid.kidney, vid.lumen, vid.camera, vid.T_kidney_camera, vid)
    kidney = phantom_of(case)
    lumen = LumenDistance.from_kidney(kidney)
    planned = plan_views(kidney, lumen, PlanSettings(views, views, around))
    return Anatomy(kidney, lumen, equidistant_camera(), planned.T_kidney_camera)


def twin_in(
    case: Case, known: Anatomy, rng: np.random.Generator, clock: SimulatedTime, stone: Array, on: TissueSettings
) -> Twin:
    """The scope at the beginning.

    Args:
        case: the phantom, and the kind of its pictures.
        known: its kidney and lens.
        rng: draws plays, faults and roll.
        clock: by which the kidney breathes, swells and bleeds.
        stone: x, y, z and radius of the stone, which the map does not know; the pictures show it.
        on: what an operation does.
    """
    kidney, lumen = known.kidney, known.lumen
    scope = Scope(backlash=(*rng.uniform(0.05, 0.15, 2), rng.uniform(0.2, 1.0)), compression_mm=2.0)
    faults = severity(PRESETS[case.kind], 0.2, rng)
    drawn = np.random.default_rng([case.seed, 22])
    tissue = Tissue(on, np.random.default_rng([case.seed, 23]), kidney.scale)
    walls = tissue.clearance(lumen.clearance_mm, clock)
    shown = Stone(stone[:3], np.full(3, stone[3]), np.eye(3), _STONE_BGR, _STONE_BUMPS, case.seed)
    world = World(kidney, RaycastRenderer(kidney.mesh, known.camera), redraw=lambda m: RaycastRenderer(m, known.camera))
    renderer = swelling_renderer(world, tissue, clock)
    start = kidney.centerline.points_mm[0]

    def picture(T: Array) -> NDArray[np.uint8]:
        now = renderer()
        image = simulate_labeled(now.render(T), now.camera, T, faults, drawn, (shown,)).image
        return tissue.picture(image, clock())

    return Twin(
        lambda p: np.minimum(walls(p), np.linalg.norm(p - stone[:3], axis=1) - stone[3]),
        picture,
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


def stone_in(known: Anatomy, rng: np.random.Generator) -> tuple[Array, int]:
    """A stone (x, y, z, radius) that closes the own branch of a calyx, and which calyx."""
    tree = known.kidney.centerline
    calyx = int(rng.integers(len(known.kidney.calyces)))
    path = tree.path_to(calyx)
    own = path[tree.calyx[path] == calyx]
    to_tip = tree.from_root_mm()[own[-1]] - tree.from_root_mm()[own]
    at = own[int(np.abs(to_tip - STONE_MM).argmin())]
    return np.array([*tree.points_mm[at], tree.radius_mm[at] + 0.2]), calyx
