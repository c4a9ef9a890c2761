"""What pictures show that no drawing does: the scope's own pattern, and stones that are known to lie there.

What the scope adds to every picture, a halo, a spot of its light, dirt on the lens, stays where it is while the wall
moves, so it is what pictures have, on average, beyond the drawings aligned with them. Subtracted, it no longer looks
like relief (flat-field correction, learned on the way). A stone that was told from afar may fill a near picture so that
nothing tells it there; the map of stones remembers it, and what it hides is not compared.
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import NO_MAPS, Features
from ursnav_torch.geometry import apply, inverse, rotation_angle
from ursnav_torch.kidney import LumenDistance

Array = NDArray[np.float64]

#: A picture teaches if its alignment scores this much and the scope has moved this far or turned this much.
_TELLING, _MOVED_MM, _TURNED_DEG = 0.55, 1.0, 10.0
#: Share of what was learned that a new picture leaves, and how many pictures of no pattern it is weighed against.
_KEPT, _AGAINST = 0.97, 4.0
#: A ball hides so much more than its apparent radius, as its place and the expected pose are not sharp: a share of it,
#: and radians. Set, not varied.
_WIDER, _BESIDE_RAD = 1.1, 0.05
#: Beyond this a ball hides too little to matter, mm at scale 1.
_FARTHEST_MM = 25.0
#: Where the line to a ball's near side is asked for walls.
_SHARES = np.linspace(0.05, 1.0, 16)


class ScopePattern:
    """The fixed pattern of one scope, learned while a track goes on.

    Args:
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    def __init__(self, unit_mm: float = 1.0) -> None:
        self._far = _MOVED_MM * unit_mm
        self._sum: Tensor | None = None
        self._count = 0.0
        self._last: Array | None = None

    def value(self) -> Tensor | None:
        """The pattern (h, w) in units of relief, at the extractor's working size; None before the first picture."""
        return None if self._sum is None else self._sum / (self._count + _AGAINST)

    def removed(self, features: Features) -> Features:
        """The relief without the pattern, with no maps: what an alignment reads, see `DefaultExtractor.with_relief`.

        Features from which nothing is removed keep their maps.
        """
        pattern = self.value()
        if pattern is None:
            return features
        return replace(features, fields=features.fields[:1] - pattern, maps=NO_MAPS)

    def tells(self, T_kidney_camera: Array, score: float) -> bool:
        """Whether a picture aligned at a pose (4, 4) with this score teaches something."""
        if score < _TELLING or self._last is None:
            return score >= _TELLING
        moved = float(np.linalg.norm(T_kidney_camera[:3, 3] - self._last[:3, 3]))
        return bool(moved > self._far or rotation_angle(T_kidney_camera, self._last) > np.radians(_TURNED_DEG))

    def learn(self, features: Features, drawn: NDArray[np.float32], T_kidney_camera: Array) -> None:
        """Take in a picture's own features, nothing removed, and the relief (H, W) drawn at its pose (4, 4).

        Where something lies before the wall the picture differs from the drawing for that reason, and teaches nothing.
        """
        relief = features.fields[0]
        larger = torch.nn.functional.interpolate(
            torch.from_numpy(drawn)[None, None], relief.shape, mode="bilinear", align_corners=False
        )[0, 0]
        beyond = relief - torch.where(relief == 0, 0.0, larger)
        beyond = beyond * features.valid if features.valid.numel() else beyond
        self._sum = beyond if self._sum is None else _KEPT * self._sum + beyond
        self._count, self._last = _KEPT * self._count + 1, T_kidney_camera


class KnownBodies:
    """Balls before the wall of one kidney, as seen through one lens.

    Args:
        lumen: distances in the kidney.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.

    Attributes:
        balls_mm: (S, 4) x, y, z in the kidney frame, and radius, as told last.
    """

    def __init__(self, lumen: LumenDistance, unit_mm: float = 1.0) -> None:
        self._lumen, self._farthest = lumen, _FARTHEST_MM * unit_mm
        self.tell(np.zeros((0, 4)))

    def tell(self, balls_mm: Array) -> None:
        """From now on these balls (S, 4) are there, and no others."""
        self.balls_mm = balls_mm

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
