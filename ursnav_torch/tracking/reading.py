"""Reading a video's pictures for a track: the relief, what lies before the wall, and what never changes left out."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.errors import FeatureError
from ursnav_torch.features import (
    NO_EDGES,
    NO_MAPS,
    NOTHING_BEFORE,
    DefaultExtractor,
    DefaultSettings,
    Features,
    StillPixels,
    relief_extractor,
)
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.tracking.own_kidney import mirrored

_LOOKED_AT = (96, 192, 384)  # after so many pictures it is looked for what never changes in them


class TrackReader:
    """Reads pictures of one lens.

    Args:
        settings: as the VID's views are read.
        camera: the VID's lens.
        learned: the wall network's share in the relief; the VID's own when None.

    Attributes:
        working_camera: the lens in which features give their fields.
        scene: (H, W) the part of the lens that shows the scene, where some was found never to change; else None.
        shown: (H, W) that part, and of it what pictures were said to show; None where they show all of the lens's.
    """

    def __init__(self, settings: DefaultSettings, camera: Camera, learned: float | None) -> None:
        self._camera = camera
        self._lens = self._whole = self._extractor = relief_extractor(settings, camera, learned)
        self.working_camera = self._extractor.working_camera
        self.scene: NDArray[np.bool_] | None = None
        self.shown: NDArray[np.bool_] | None = None
        self.reset()

    def reset(self) -> None:
        """Look anew for what never changes in the pictures; what was found before holds until then."""
        self._still = StillPixels(self._camera.pixel_rays()[1])

    @property
    def lens_mask(self) -> Tensor:
        """(h, w) 1.0 where pictures at the working size are to be trusted."""
        return self._extractor.lens_mask

    def read(self, image: NDArray[np.uint8], edges: bool, shown: bool = False) -> Features | None:
        """What a track needs of a picture (H, W) or (H, W, 3), None where it shows nothing.

        Args:
            image: the picture.
            edges: whether the search compares edge points.
            shown: whether somebody wants to see them. A picture with too few to be seen is tracked all the same.

        Raises:
            InputError: the picture cannot be of this lens.
        """
        self._look_for_the_scene(image)
        with torch.inference_mode(), one_thread_an_operation():
            try:
                return self._extractor.extract(image, edges=edges or shown, bare=True)
            except FeatureError:
                pass
        return self.read(image, edges) if shown and not edges else None

    def narrow(self, scene: NDArray[np.bool_]) -> None:
        """From now on pictures show the scene in a part (H, W) of the lens alone."""
        self._whole = self._whole.through(scene)
        self._look_through(self._whole)

    def _look_for_the_scene(self, image: NDArray[np.uint8]) -> None:
        """Leave out what never changes in the first pictures: a narrower mask, burnt-in text. The last look counts."""
        looked = self._still.count
        if looked < _LOOKED_AT[-1] and image.shape[:2] == (self._camera.height, self._camera.width):
            self._still.add(image)
            if looked + 1 in _LOOKED_AT:
                self.scene = self._still.scene()
                self._look_through(self._whole if self.scene is None else self._whole.through(self.scene))

    def _look_through(self, extractor: DefaultExtractor) -> None:
        """Read the next pictures by an extractor of a part of the lens."""
        self._extractor = extractor
        self.shown = None if extractor is self._lens else extractor.camera.pixel_rays()[1]

    def mapped(self, features: Features) -> Features:
        """Features with the maps that views are searched by."""
        return features if features.maps.numel() else self._extractor.with_relief(features, features.fields[0])

    def mirrored(self, features: Features) -> Features:
        """The features, with maps, of the picture that another kidney, this one's mirror image, would give."""
        planes = mirrored(planes_of(features), self.working_camera)
        return self._extractor.with_relief(recalled(planes), planes[0])


def planes_of(features: Features) -> Tensor:
    """What `recalled` needs of features: the relief (1, h, w), and what is valid (2, h, w) where not all is."""
    relief = features.fields[:1]
    return torch.cat([relief, features.valid[None]]) if features.valid.numel() else relief


def recalled(planes: Tensor) -> Features:
    """What a track goes on with, from no more than the planes (P, h, w) that `planes_of` kept."""
    valid = planes[1] if len(planes) > 1 else NOTHING_BEFORE
    return Features(NO_EDGES, NO_MAPS, np.zeros((0, 0), bool), planes[:1], valid=valid)
