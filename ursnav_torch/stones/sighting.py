"""Cones of sight: a stone's region in a picture as a direction and apparent sizes, through the lens as it is."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import Array

#: A region nearer to the lens's edge than this share of the picture may go on beyond it: near the edge the finder sees
#: less of a stone than there is.
_RIM = 0.07


@dataclass(frozen=True, slots=True, eq=False)
class StoneSighting:
    """A stone as one picture shows it.

    Attributes:
        ray: (3,) unit, camera frame, to its middle.
        half_angle: of the cone that covers as much of the sphere of directions, radians.
        extent: angle between the two points of its outline that lie farthest apart, radians.
        is_whole: whether all of it lies in the picture.
        probability: that it is a stone, of this picture alone.
    """

    ray: Array
    half_angle: float
    extent: float
    is_whole: bool
    probability: float


class ConeOfSight:
    """Makes sightings of regions.

    Args:
        working_camera: the lens at the size of the regions' masks.

    Attributes:
        solid_angle: of the whole picture, steradian.
    """

    def __init__(self, working_camera: Camera) -> None:
        self.camera = working_camera
        self._rays, inside = working_camera.pixel_rays()
        across = np.cross(np.gradient(self._rays, axis=1), np.gradient(self._rays, axis=0))
        self._steradian = np.linalg.norm(across, axis=2) * inside
        self._rim = inside & (ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1] < _RIM * min(inside.shape))
        self.solid_angle = float(self._steradian.sum())

    def sightings(self, bodies: Iterable[ForegroundBody]) -> tuple[StoneSighting, ...]:
        """The stones among the bodies of a picture."""
        return tuple(self._sighting(body) for body in bodies if body.kind == "stone")

    def _sighting(self, body: ForegroundBody) -> StoneSighting:
        weight = self._steradian[body.mask]
        ray = weight @ self._rays[body.mask]
        half = float(np.arccos(np.clip(1 - weight.sum() / (2 * np.pi), -1, 1)))
        outline = body.mask & ~ndimage.binary_erosion(body.mask)
        rays = self._rays[outline]
        pixel = float(np.sqrt(weight.mean()))  # from the middles of the outline's pixels to their outer edges
        extent = float(np.arccos(np.clip(rays @ rays.T, -1, 1)).max()) + pixel
        return StoneSighting(
            ray / np.linalg.norm(ray), half, extent, not bool((body.mask & self._rim).any()), body.probability
        )
