"""What of a source's pictures never changes: a narrower lens mask, text and marks burnt in.

A scope that moves changes every pixel of the scene; what stays as it is over many pictures is none of it.
"""

from collections.abc import Sequence
from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

#: So many pictures at least tell what never changes; in a video, whose pictures resemble each other, it takes more.
ENOUGH = 12
#: Gray values within which a pixel's extremes lie where it never changes; JPEG alone moves a pixel by a few. What
#: changes by more than that and less than `_CHANGED` may be either.
_STILL, _CHANGED = 10, 30
#: Such doubtful pixels are at most this many for one that never changes: else the scope has not moved enough. What is
#: burnt in parts pixels into two kinds (``python -m benchmarks.still_pixels``: doubtful for still ones, clean flights
#: of a slow scope against overlaid ones).
_DOUBTFUL = 0.5
#: Darker than this at all times is black; black that does not reach the border may be a deep calyx.
_BLACK = 16
#: Share of the lens's own mask that must be found covered to be worth a mask; edges of a mask are uncertain by this
#: share of the shorter side.
_WORTH, _RIM = 0.01, 0.012


class StillPixels:
    """Extremes of every pixel over the pictures of one source.

    Args:
        inside: (H, W) bool, where the calibrated lens has its picture.
    """

    def __init__(self, inside: NDArray[np.bool_]) -> None:
        self._inside = inside
        self._low: NDArray[np.uint8] = np.full(inside.shape, 255, np.uint8)
        self._high: NDArray[np.uint8] = np.zeros(inside.shape, np.uint8)
        self.count = 0

    def add(self, image: NDArray[np.uint8]) -> None:
        """Take in a picture (H, W) or (H, W, 3)."""
        gray = image if image.ndim == 2 else reduce(np.maximum, np.moveaxis(image, 2, 0))  # ten times as fast as max(2)
        self._low, self._high = np.minimum(self._low, gray), np.maximum(self._high, gray)
        self.count += 1

    def counts(self) -> tuple[int, int]:
        """Pixels inside that never changed, and those that changed too little to tell."""
        here = self._change()[self._inside]
        return int(np.sum(here <= _STILL)), int(np.sum((here > _STILL) & (here < _CHANGED)))

    def _change(self) -> NDArray[np.int16]:
        return self._high.astype(np.int16) - self._low

    def scene(self) -> NDArray[np.bool_] | None:
        """Where the scene is seen (H, W); None as long as that cannot be told, or where it is the lens's own mask."""
        if self.count < ENOUGH or not self._inside.any():
            return None
        still_count, doubtful = self.counts()
        if doubtful > _DOUBTFUL * still_count or np.median(self._change()[self._inside]) < _CHANGED:
            return None
        still = (self._change() <= _STILL).astype(np.uint8)
        black = ((self._high < _BLACK) & (still > 0)).astype(np.uint8)
        covered = (still > 0) & ~(black > 0) | _at_border(black, self._inside)
        size = max(3, round(_RIM * min(covered.shape)) | 1)
        solid = cv2.morphologyEx(covered.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        grown = cv2.dilate(cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((size, size))), np.ones((size, size))) > 0
        scene = self._inside & ~grown
        lost = float((self._inside & ~scene).sum()) / float(self._inside.sum())
        rim = self._inside & cv2.erode(self._inside.astype(np.uint8), np.ones((2 * size + 1,) * 2)).astype(bool)
        beyond = float((rim & ~scene).sum()) / float(self._inside.sum())
        return scene if lost > _WORTH and beyond > _WORTH and scene.any() else None


def scene_of(pictures: Sequence[NDArray[np.uint8]], inside: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """`StillPixels.scene` of pictures (H, W) or (H, W, 3), those of another size than the lens's left out."""
    seen = StillPixels(inside)
    for image in pictures:
        if image.shape[:2] == inside.shape:
            seen.add(image)
    return seen.scene()


def _at_border(black: NDArray[np.uint8], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The parts of black (H, W) that reach the picture's border, or where the lens has no picture."""
    around = cv2.copyMakeBorder(np.maximum(black, (~inside).astype(np.uint8)), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    _, label = cv2.connectedComponents(around, connectivity=8)
    return np.asarray((label == label[0, 0])[1:-1, 1:-1])
