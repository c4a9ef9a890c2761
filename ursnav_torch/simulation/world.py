"""What a simulated scope lives in, and the scope put into it."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import Renderer
from ursnav_torch.simulation.em_field import EmField
from ursnav_torch.simulation.tissue import Tissue
from ursnav_torch.simulation.twin import Scope, Twin

if TYPE_CHECKING:
    from ursnav_torch.simulation.stones import ObstructedLumen


@dataclass(frozen=True, slots=True)
class World:
    """What a twin lives in.

    Attributes:
        kidney: the anatomy.
        renderer: draws it through the scope's lens.
        lumen: its distances where they are known already, as a VID knows them, or with what lies in it; None finds
            them when a twin is made.
        redraw: makes what draws the kidney once its wall has moved; None draws it where it was.
        clock: seconds by which it breathes, swells and bleeds.
    """

    kidney: Kidney
    renderer: Renderer
    lumen: "LumenDistance | ObstructedLumen | None" = None
    redraw: Callable[[trimesh.Trimesh], Renderer] | None = None
    clock: Callable[[], float] = time.monotonic


#: Draws a picture uint8 with a renderer from a pose (4, 4).
Draw = Callable[[Renderer, Array], NDArray[np.uint8]]


def clean(renderer: Renderer, T: Array) -> NDArray[np.uint8]:
    """A picture (H, W) without faults."""
    return renderer.render(T).image


def operated_twin(
    world: World,
    T_kidney_start: Array,
    scope: Scope | None,
    tissue: Tissue,
    em: EmField | None = None,
    draw: Draw = clean,
) -> Twin:
    """A scope in a kidney that breathes, swells and bleeds by the world's clock, from now on.

    Args:
        world: the anatomy, what draws it, and the clock.
        T_kidney_start: pose (4, 4) of the tip, withdrawn.
        scope: the scope; where the tissue has friction, it buckles by that.
        tissue: what happens.
        em: the EM tracker's world.
        draw: makes pictures, before blood comes into them.

    Raises:
        InputError: the start lies in a wall.
    """
    scope, begun_s = scope or Scope(), world.clock()

    def since() -> float:
        return world.clock() - begun_s

    lumen = world.lumen or LumenDistance.from_kidney(world.kidney)
    renderer = swelling_renderer(world, tissue, since)
    return Twin(
        _room(lumen, tissue, since),
        lambda T: tissue.picture(draw(renderer(), T), since()),
        T_kidney_start,
        replace(scope, friction=tissue.friction) if tissue.settings.buckles else scope,
        em,
        breathing=(lambda: tissue.breath_mm(since())) if tissue.settings.breathes else None,
    )


def _room(
    lumen: "LumenDistance | ObstructedLumen", tissue: Tissue, since: Callable[[], float]
) -> Callable[[Array], Array]:
    """Distances (N,) mm of points (N, 3) to what stops the scope: the wall as it is now, and stones, which stay."""
    if isinstance(lumen, LumenDistance):
        return tissue.clearance(lumen.clearance_mm, since)
    walls = tissue.clearance(lumen.lumen.clearance_mm, since)
    return lambda points_mm: np.minimum(walls(points_mm), lumen.to_stones_mm(points_mm))


def swelling_renderer(world: World, tissue: Tissue, since: Callable[[], float]) -> Callable[[], Renderer]:
    """What draws the kidney as it is now; made anew whenever its wall has moved by a step."""
    redraw, made = world.redraw, {0.0: world.renderer}
    if redraw is None or not tissue.settings.swells:
        return lambda: world.renderer
    mesh = world.kidney.mesh

    def now() -> Renderer:
        mm = tissue.redrawn_mm(since())
        if mm not in made:
            moved = np.asarray(mesh.vertices) + mm * np.asarray(mesh.vertex_normals)
            made[mm] = redraw(trimesh.Trimesh(moved, mesh.faces, process=False))
        return made[mm]

    return now
