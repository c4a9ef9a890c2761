"""Where a scope's picture is on its frame, and which parts of it no corner of the board came to."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera

#: Gray value that no lit part of the picture stays below in all pictures; or a quarter of the median.
_DARK = 16
#: A dark surround of less than this part of the frame is none: the whole frame is the picture.
_LEAST_SURROUND = 0.01
#: Parts of less than this share of the picture are not asked for.
_LEAST_PART = 0.015
#: Rings by their outer edge as a part of the way to the picture's end in that direction, and sectors of the outer two.
_RINGS, _SECTORS = (0.35, 0.7, 1.0), 8
_WAYS = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")
_PLACES = ("the middle", "half-way to the {way}", "the rim at the {way}")


@dataclass(frozen=True, slots=True)
class FieldCoverage:
    """How much of the picture the board's corners came to.

    Attributes:
        share: of the picture's parts (its middle, eight half-way out and eight at the rim), those with a corner.
        empty: the parts without one, in words, the middle first.
        part: (H, W) the number of each pixel's part, -1 outside the picture.
        without: numbers of the empty parts.
    """

    share: float
    empty: tuple[str, ...]
    part: NDArray[np.int64]
    without: tuple[int, ...]


def picture_mask(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.bool_] | None:
    """(H, W) where the scope's picture is on the frame; None where it fills the frame.

    It is the convex hull of what is lit in any of the pictures (H, W) or (H, W, 3): circles, cut circles and rounded
    rectangles are convex, and what stays dark inside of them is the picture's, too.
    """
    lit = _lit(_brightest(images)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(lit)
    if count < 2:
        return None
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    outline = cv2.findContours((labels == largest).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    hull = np.zeros_like(lit)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.concatenate(outline)), 1)
    mask = hull > 0
    return None if 1 - float(mask.mean()) < _LEAST_SURROUND else mask


def round_picture_fov(images: Sequence[NDArray[np.uint8]], camera: Camera) -> float | None:
    """Full angle of the image circle in degrees where the corners of pictures (H, W) stay black, else None."""
    lit = _lit(_brightest(images))
    v, u = np.indices(lit.shape)
    ring = np.hypot(u - camera.cx, v - camera.cy).astype(int).ravel()
    rings = np.bincount(ring, lit.ravel()) / np.bincount(ring)
    bright = np.flatnonzero(rings > 0.5)
    if len(bright) == 0 or rings[-1] > 0.5 or bright[-1] + 2 >= len(rings):
        return None
    rim = camera.rays([camera.cx + bright[-1] + 0.5, camera.cy])[0]
    return math.degrees(2 * math.acos(float(np.clip(rim[2], -1, 1))))


def field_coverage(pixels: NDArray[np.float64], mask: NDArray[np.bool_]) -> FieldCoverage:
    """Which parts of the picture corners at ``pixels`` (N, 2) came to; ``mask`` (H, W) is where the picture is."""
    part = _parts(mask)
    at = np.clip(np.rint(pixels).astype(int), 0, np.array(mask.shape)[::-1] - 1)
    reached = set(part[at[:, 1], at[:, 0]].tolist())
    count = np.bincount(part[mask], minlength=1 + 2 * _SECTORS)
    asked = [p for p in range(len(count)) if count[p] >= _LEAST_PART * count.sum()]
    without = tuple(p for p in asked if p not in reached)
    share = 1 - len(without) / max(len(asked), 1)
    return FieldCoverage(share, tuple(_in_words(p) for p in without), part, without)


def _brightest(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """The brightest that each pixel (H, W) was, without single specks."""
    gray = [image if image.ndim == 2 else image.max(axis=2) for image in images]
    return np.asarray(cv2.medianBlur(np.max(gray, axis=0), 3))


def _lit(brightest: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(brightest > max(_DARK, 0.25 * float(np.median(brightest))))


def _parts(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(H, W) 0 in the middle, 1 to 8 half-way out, 9 to 16 at the rim, each from the right clockwise; -1 outside."""
    v, u = np.nonzero(mask)
    x, y = u - u.mean(), v - v.mean()
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    bins = np.floor((angle + math.pi) / (2 * math.pi) * 72).astype(int) % 72
    end = np.zeros(72)
    np.maximum.at(end, bins, radius)
    away = radius / np.maximum(end[bins], 1e-9)
    sector = np.rint(angle / (2 * math.pi / _SECTORS)).astype(int) % _SECTORS
    ring = np.searchsorted(_RINGS[:-1], away, side="right")
    part = np.full(mask.shape, -1)
    part[v, u] = np.where(ring == 0, 0, 1 + (ring - 1) * _SECTORS + sector)
    return part


def _in_words(part: int) -> str:
    ring, sector = (0, 0) if part == 0 else (1 + (part - 1) // _SECTORS, (part - 1) % _SECTORS)
    return _PLACES[ring].format(way=_WAYS[sector])
