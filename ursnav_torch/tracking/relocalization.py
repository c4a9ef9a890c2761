"""Relocalization: the picture of a track that is unsure of its place, located anew as a still is.

A track aligns what motion and a quick search lead to, by the light alone. A still's way has no past that may be wrong:
it reads the wall with the network, compares every view by shapes, too, verifies, and knows how sure it is. It takes
its time besides, so that only the pictures are asked that a track cannot place by itself.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import Features
from ursnav_torch.localization import Localizer
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RelocalizationSettings:
    """When a picture is located anew, and what that counts.

    Attributes:
        above_mm: where the region that holds the position with 90 % reaches farther, and where there is no place; inf
            never asks. 2 and 3 mm and never: a place in 94.8, 95.2 and 94.1 % of the choosing flights' pictures, 0.8,
            0.8 and 1.0 % of these more than 3 mm off (`benchmarks.flights phantoms=16 half=choosing
            vary=relocalization.above_mm=2,inf`).
    """

    above_mm: float = 3.0

    def __post_init__(self) -> None:
        if not self.above_mm > 0:
            raise InputError(f"Expected relocalization.above_mm > 0, got {self.above_mm}.")


@dataclass(frozen=True, slots=True)
class Relocated:
    """Where a picture alone was surely taken.

    Attributes:
        T_kidney_camera: (4, 4).
        position_sd_mm: two of three positions are within this.
    """

    T_kidney_camera: Array
    position_sd_mm: float


class Relocalizer:
    """Locates single pictures of a video in one VID, as `Localizer` does with its defaults."""

    def __init__(self, vid: Vid) -> None:
        self._whole = self._localizer = Localizer(vid)
        self._scene: NDArray[np.bool_] | None = None

    def narrow(self, scene: NDArray[np.bool_]) -> None:
        """From now on pictures show the scene in a part (H, W) of the lens alone."""
        self._whole.narrow(scene)
        self._localizer, self._scene = self._whole, None

    def look_through(self, scene: NDArray[np.bool_] | None) -> None:
        """The next pictures show it in a part (H, W) of that, as was found meanwhile; in all of it when None."""
        if scene is not self._scene:
            self._scene, self._localizer = scene, copy(self._whole)
            if scene is not None:
                self._localizer.narrow(scene)

    def locate(self, image: NDArray[np.uint8], seen: Features) -> Relocated | None:
        """Where a picture (H, W) or (H, W, 3) was taken.

        Args:
            image: the picture.
            seen: its features as the track has them, which tell what of it is wall.

        Returns:
            None where it shows too little, or the answer is not one that a localizer accepts, see
            `LocalizationSettings.risk`.
        """
        if not self._localizer.knows_confidence:  # then none is accepted
            return None
        try:
            features = self._localizer.features(image)
        except FeatureError:
            return None
        if seen.valid.numel():
            own = features.valid
            features = replace(features, valid=torch.minimum(own, seen.valid) if own.numel() else seen.valid)
        found = self._localizer.locate_features(features)
        return Relocated(found.T_kidney_camera, found.position_sd_mm) if found.accepted else None
