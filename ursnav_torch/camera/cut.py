"""Pictures of the calibrated camera that were cropped or scaled, put back to where they lie in the calibrated one."""

import warnings
import zlib
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera.lens import Camera

#: Pictures scaled by less or more are another camera's: below, nothing is left to match; above, no grabber goes.
_SMALLEST, _LARGEST = 0.25, 16.0
#: What rounding to whole pixels leaves of one ratio, px of the picture.
_ROUNDED_PX = 0.75
#: A lens that shows less of the scene by this share of its picture, in a mask or a circle of its own, is narrower.
_NARROWER = 0.01


@dataclass(frozen=True, slots=True)
class PictureCut:
    """Where pictures lie in those of a lens.

    Attributes:
        lens: whose pictures are wanted.
        width, height: of the pictures that come, px.
        x, y, w, h: the part of the lens's picture that they show, px of the lens's.
        scene: (H, W) where they show the scene, as their own lens has a mask or a circle; None: as the lens's do.
    """

    lens: Camera
    width: int
    height: int
    x: int
    y: int
    w: int
    h: int
    scene: NDArray[np.bool_] | None = field(default=None, compare=False)

    @property
    def narrows(self) -> bool:
        """Whether the pictures show less than the lens's do."""
        return not self.is_whole or self.scene is not None

    @property
    def is_whole(self) -> bool:
        """Whether the pictures are as wide and high as the lens's are."""
        return (self.x, self.y, self.w, self.h) == (0, 0, self.lens.width, self.lens.height)

    def numbers(self) -> list[int]:
        """Width, height, x, y, w, h, and a checksum of the scene, 0 without one: what tells it from another."""
        scene = 0 if self.scene is None else zlib.crc32(np.packbits(self.scene).tobytes())
        return [self.width, self.height, self.x, self.y, self.w, self.h, scene]

    def inside(self) -> NDArray[np.bool_]:
        """(H, W) where the lens's picture is known."""
        there = np.zeros((self.lens.height, self.lens.width), bool)
        there[self.y : self.y + self.h, self.x : self.x + self.w] = True
        return there if self.scene is None else there & self.scene

    def through(self, taken: Camera) -> "PictureCut":
        """The same of pictures that were ``taken`` through a lens with a mask or a circle of its own."""
        part = _resized(taken.pixel_rays()[1].astype(np.uint8), self.w, self.h) > 0
        scene = np.zeros((self.lens.height, self.lens.width), bool)
        scene[self.y : self.y + self.h, self.x : self.x + self.w] = part
        shown = self.inside() & self.lens.pixel_rays()[1]
        is_narrower = (shown & ~scene).sum() > _NARROWER * shown.sum()
        return replace(self, scene=scene) if is_narrower else self

    def put_back(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A picture as the lens gives it (H, W) or (H, W, 3), black where it was cut away.

        One of another size than the cut's is put back where one ratio tells its scale, and else comes back as it is.
        """
        if image.shape[:2] != (self.height, self.width):
            return scaled_to(image, self.lens)
        part = _resized(image, self.w, self.h)
        if self.is_whole:
            return part
        whole = np.zeros((self.lens.height, self.lens.width, *image.shape[2:]), np.uint8)
        whole[self.y : self.y + self.h, self.x : self.x + self.w] = part
        return whole


def cut_of(taken: Camera, lens: Camera) -> PictureCut | None:
    """Where pictures that were ``taken`` through a lens lie in those of ``lens``; None: they are of another lens."""
    sx, sy = taken.fx / lens.fx, taken.fy / lens.fy
    x, y = ((c + 0.5) - (t + 0.5) / s for c, t, s in ((lens.cx, taken.cx, sx), (lens.cy, taken.cy, sy)))
    left, top = round(x), round(y)
    w, h = round(taken.width / sx), round(taken.height / sy)
    if left < 0 or top < 0 or left + w > lens.width or top + h > lens.height or min(w, h) < 8:
        return None
    again = lens.cropped(left, top, w, h).resized(taken.width, taken.height)
    found = PictureCut(lens, taken.width, taken.height, left, top, w, h)
    return found.through(taken) if again.same_lens(taken) else None


def scaled_to(image: NDArray[np.uint8], lens: Camera) -> NDArray[np.uint8]:
    """A picture (H, W) or (H, W, 3) at the lens's size where one ratio scaled it, said in a warning; else as it is."""
    height, width = image.shape[:2]
    if (width, height) == (lens.width, lens.height) or not _one_ratio(width, height, lens):
        return image
    warnings.warn(
        f"Pictures of {width} x {height} px are taken for the lens's {lens.width} x {lens.height} px, scaled by "
        f"{width / lens.width:.3g}. If they were cropped, say so by camera=file camera.path=CALIBRATION "
        "camera.crop=[x,y,w,h] camera.resize=[w,h].",
        stacklevel=2,
    )
    return _resized(image, lens.width, lens.height)


def _one_ratio(width: int, height: int, lens: Camera) -> bool:
    ratio = (width + height) / (lens.width + lens.height)
    off = abs(width - ratio * lens.width), abs(height - ratio * lens.height)
    return _SMALLEST <= ratio <= _LARGEST and max(off) <= _ROUNDED_PX


def _resized(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """By areas where it gets smaller, so that no grain is made of fine structure; pixel centers as `Camera.resized`."""
    if image.shape[:2] == (height, width):
        return image
    smaller = width < image.shape[1]
    return np.asarray(
        cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR), np.uint8
    )
