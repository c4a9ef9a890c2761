"""The whole way from a rendered wall to an 8-bit picture with faults."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.base import Renderer, View
from ursnav_torch.rendering.sensor.bodies import CLUTTER, WALL, BodyFaults, Stone, place_stones, with_bodies
from ursnav_torch.rendering.sensor.electronics import ElectronicsFaults, digitize
from ursnav_torch.rendering.sensor.light import LightFaults, lamp_place, shade
from ursnav_torch.rendering.sensor.occluders import OccluderFaults, occlude
from ursnav_torch.rendering.sensor.optics import OpticsFaults, through_lens
from ursnav_torch.rendering.sensor.surface import lens_rays, surface_of
from ursnav_torch.rendering.sensor.wall import WallFaults, paint

#: Debris, bubbles and blood count as clutter where they change a picture value (0 to 1) by this much.
_COVERED = 0.12


@dataclass(frozen=True, slots=True)
class SensorFaults:
    """Everything that spoils a picture, in the order of the light's way; the default is a clean gray picture."""

    wall: WallFaults = field(default_factory=WallFaults)
    light: LightFaults = field(default_factory=LightFaults)
    bodies: BodyFaults = field(default_factory=BodyFaults)
    occluders: OccluderFaults = field(default_factory=OccluderFaults)
    optics: OpticsFaults = field(default_factory=OpticsFaults)
    electronics: ElectronicsFaults = field(default_factory=ElectronicsFaults)


@dataclass(frozen=True, slots=True)
class Labeled:
    """A simulated picture and what is in it.

    Attributes:
        image: (H, W, 3) uint8, blue green red.
        kind: (H, W) uint8, `bodies.WALL`, `STONE`, `INSTRUMENT` or `CLUTTER`.
        stones: those in the kidney, in sight or not.
    """

    image: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    stones: tuple[Stone, ...]


def simulate(
    renderer: Renderer, T_kidney_camera: NDArray[np.float64], faults: SensorFaults, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """A scope picture (H, W, 3), uint8, blue green red, from one pose.

    Args:
        renderer: draws the kidney through the scope's lens; only its depth and normals are used.
        T_kidney_camera: (4, 4).
        faults: the settings of every fault; what belongs to the wall or the scope stays put for a whole video.
        rng: what changes from picture to picture: noise, places of debris and bubbles, phase of the stripes.
    """
    return simulate_view(renderer.render(T_kidney_camera), renderer.camera, T_kidney_camera, faults, rng)


def simulate_view(
    view: View, camera: Camera, T_kidney_camera: NDArray[np.float64], faults: SensorFaults, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The picture (H, W, 3) of `simulate` from a view already rendered through ``camera`` at the pose (4, 4)."""
    return simulate_labeled(view, camera, T_kidney_camera, faults, rng).image


def simulate_labeled(
    view: View,
    camera: Camera,
    T_kidney_camera: NDArray[np.float64],
    faults: SensorFaults,
    rng: np.random.Generator,
    stones: Sequence[Stone] | None = None,
) -> Labeled:
    """`simulate_view` with the truth on what lies before the wall.

    Args:
        view, camera, T_kidney_camera, faults, rng: see `simulate`.
        stones: those of the kidney, which stay put for a whole video; drawn anew where None.
    """
    surface = surface_of(view, camera, T_kidney_camera)
    mask = lens_rays(camera)[1]
    led = lamp_place(surface, faults.light)
    if stones is None:
        stones = place_stones(surface, T_kidney_camera, faults.bodies, rng) if len(surface.pixels) else ()
    seen = with_bodies(surface, paint(surface, faults.wall), T_kidney_camera, faults.bodies, stones, led)
    picture = np.zeros((mask.size, 3), np.float32)
    picture[surface.pixels] = shade(seen.surface, seen.wall, faults.light, led, seen.lit)
    picture = picture.reshape(*mask.shape, 3)
    flat = np.zeros(mask.size, np.uint8)
    flat[surface.pixels] = seen.kind
    kind = flat.reshape(mask.shape)
    covered = occlude(picture, mask, camera, faults.occluders, rng)
    kind[(np.abs(covered - picture).max(2) > _COVERED) & (kind == WALL)] = CLUTTER
    covered = through_lens(covered, mask, camera, faults.optics, rng)
    return Labeled(digitize(covered, mask, faults.electronics, rng), kind, tuple(stones))
