"""What the scope itself adds to every picture: a halo, a spot of its light, dirt on the lens.

It stays where it is while the wall moves, so it is what pictures have, on average, beyond the drawings aligned with
them. Subtracted, it no longer looks like relief (flat-field correction, learned on the way).
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.features import NO_MAPS, Features
from ursnav_torch.geometry import rotation_angle

Array = NDArray[np.float64]

#: A picture teaches if its alignment scores this much and the scope has moved this far or turned this much.
_TELLING, _MOVED_MM, _TURNED_DEG = 0.55, 1.0, 10.0
#: Share of what was learned that a new picture leaves, and how many pictures of no pattern it is weighed against.
_KEPT, _AGAINST = 0.97, 4.0


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
