"""What a renderer takes and gives."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera


@dataclass(frozen=True, slots=True)
class View:
    """One picture of the lumen from inside.

    Attributes:
        image: (H, W) uint8, gray; black outside the image circle.
        depth_mm: (H, W) float32, distance *along the ray* from the camera to the wall in mm;
            inf where the ray leaves through an opening, nan outside the image circle.
        normals: (H, W, 3) float32, unit wall normals in the camera frame, pointing at the camera;
            zero where there is no wall.
    """

    image: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    normals: NDArray[np.float32]


class Renderer(Protocol):
    """Draws a kidney from inside; ``camera`` is the lens it draws through."""

    camera: Camera

    def render(self, T_kidney_camera: NDArray[np.float64]) -> View:
        """The view from one pose (4, 4)."""
        ...
