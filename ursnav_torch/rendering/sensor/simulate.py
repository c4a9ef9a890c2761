"""The whole way from a rendered wall to an 8-bit picture with faults."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.rendering.base import Renderer, View
from ursnav_torch.rendering.sensor.electronics import ElectronicsFaults, digitize
from ursnav_torch.rendering.sensor.light import LightFaults, shade
from ursnav_torch.rendering.sensor.occluders import OccluderFaults, occlude
from ursnav_torch.rendering.sensor.optics import OpticsFaults, through_lens
from ursnav_torch.rendering.sensor.surface import lens_rays, surface_of
from ursnav_torch.rendering.sensor.wall import WallFaults, paint


@dataclass(frozen=True, slots=True)
class SensorFaults:
    """Everything that spoils a picture, in the order of the light's way; the default is a clean gray picture."""

    wall: WallFaults = field(default_factory=WallFaults)
    light: LightFaults = field(default_factory=LightFaults)
    occluders: OccluderFaults = field(default_factory=OccluderFaults)
    optics: OpticsFaults = field(default_factory=OpticsFaults)
    electronics: ElectronicsFaults = field(default_factory=ElectronicsFaults)


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
    """`simulate` from a view that is already rendered through ``camera``."""
    surface = surface_of(view, camera, T_kidney_camera)
    mask = lens_rays(camera)[1]
    picture = np.zeros((mask.size, 3), np.float32)
    picture[surface.pixels] = shade(surface, paint(surface, faults.wall), faults.light)
    picture = picture.reshape(*mask.shape, 3)
    picture = occlude(picture, mask, camera, faults.occluders, rng)
    picture = through_lens(picture, mask, camera, faults.optics, rng)
    return digitize(picture, mask, faults.electronics, rng)
