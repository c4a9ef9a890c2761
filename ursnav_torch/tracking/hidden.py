"""What is known to lie before the wall: where it hides the wall, a picture is not compared with a drawing without it.

A stone that was told from afar may fill a near picture so that nothing tells it there; the map of stones remembers it.
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import Features
from ursnav_torch.geometry import apply, inverse
from ursnav_torch.kidney import LumenDistance

Array = NDArray[np.float64]

#: A ball hides so much more than its apparent radius, as its place and the expected pose are not sharp: a share of it,
#: and radians. Set, not varied.
_WIDER, _BESIDE_RAD = 1.1, 0.05
#: Beyond this a ball hides too little to matter, mm at scale 1.
_FARTHEST_MM = 25.0
#: Where the line to a ball's near side is asked for walls.
_SHARES = np.linspace(0.05, 1.0, 16)


class KnownBodies:
    """Balls before the wall of one kidney, as seen through one lens.

    Args:
        lumen: distances in the kidney.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.

    Attributes:
        balls_mm: (S, 4) x, y, z in the kidney frame, and radius.
    """

    def __init__(self, lumen: LumenDistance, unit_mm: float = 1.0) -> None:
        self._lumen, self._farthest = lumen, _FARTHEST_MM * unit_mm
        self.balls_mm: Array = np.zeros((0, 4))

    def left_out(self, features: Features, T_kidney_camera: Array, camera: Camera, lens_mask: Tensor) -> Features:
        """Features of which the pixels that balls hide from about a pose (4, 4) are not valid.

        Args:
            features: of a picture.
            T_kidney_camera: where it may have been taken.
            camera, lens_mask: the lens at the extractor's working size, and what of it is trusted (h, w).
        """
        seen = [ball for ball in self.balls_mm if self._in_sight(ball, T_kidney_camera[:3, 3])]
        if not seen:
            return features
        rays, _ = camera.pixel_rays()
        free = np.ones(rays.shape[:2], bool)
        centers = apply(inverse(T_kidney_camera), np.array(seen)[:, :3])
        for center, radius in zip(centers, np.array(seen)[:, 3], strict=True):
            away = float(np.linalg.norm(center))
            half = _WIDER * float(np.arcsin(min(radius / away, 1.0))) + _BESIDE_RAD
            free &= rays @ (center / away) < np.cos(min(half, np.pi))
        valid = features.valid if features.valid.numel() else lens_mask
        return replace(features, valid=valid * torch.from_numpy(free.astype(np.float32)))

    def _in_sight(self, ball: Array, place_mm: Array) -> bool:
        """Whether no wall stands between a place (3,) and the near side of a ball (4,), and it is near enough."""
        way = ball[:3] - place_mm
        away = float(np.linalg.norm(way))
        if not 0 < away - ball[3] < self._farthest:
            return False
        points = place_mm + _SHARES[:, None] * (1 - ball[3] / away) * way
        return bool((self._lumen.clearance_mm(points) > 0).all())
