"""Binary images to outlines: ordered points around the largest part of a silhouette."""

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from ursnav_torch.errors import InputError

Floats = NDArray[np.float64]

#: Smoothing of the outline, as a share of its length and at least in px: takes the stairs of pixels out.
_SMOOTHING, _SMOOTHING_PX = 0.003, 1.5


@dataclass(frozen=True, slots=True)
class Outline:
    """An outline sampled evenly by length.

    Attributes:
        points: (P, 2) px, running clockwise as seen on the screen (x right, y down).
        tangents: (P,) direction of the outline in radians, x towards y.
    """

    points: Floats
    tangents: Floats


def read_silhouettes(folder: Path) -> list[tuple[str, NDArray[np.uint8]]]:
    """Class and image of every ``class-number.png`` in a folder, in name order.

    The class is all before the last hyphen and may itself hold hyphens and digits; the suffix may be in upper
    case; other files are passed over.

    Raises:
        InputError: no such file, or one that cannot be read.
    """
    found = []
    for path in sorted(folder.iterdir() if folder.is_dir() else []):
        match = re.fullmatch(r"(.+)-\d+\.png", path.name, re.IGNORECASE)
        if not match:
            continue
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) if path.stat().st_size else None
        if image is None:
            raise InputError(f"{path} cannot be read as an image; it may be cut short.")
        found.append((match[1], image))
    if not found:
        raise InputError(f"{folder} holds no file named class-number.png; give data=FOLDER with such images.")
    return found


def silhouette_mask(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Where the shape is (H, W): the side of the middle gray that is rarer along the image's border.

    Args:
        image: (H, W), (H, W, 3) or (H, W, 4), any depth; where there is transparency, it alone counts if the
            colors do not differ.

    Raises:
        InputError: the image is of one gray.
    """
    gray = image.astype(float)
    if image.ndim == 3:
        colors = gray[..., :3].mean(2)
        gray = gray[..., 3] if image.shape[2] == 4 and np.ptp(colors) == 0 else colors
    if np.ptp(gray) == 0:
        raise InputError(f"An image of {gray.shape[1]} x {gray.shape[0]} px is of one gray and shows no shape.")
    bright = gray > (gray.min() + gray.max()) / 2
    border = np.concatenate([bright[0], bright[-1], bright[1:-1, 0], bright[1:-1, -1]])
    return ~bright if border.mean() > 0.5 else bright


def outline(image: NDArray[np.uint8], count: int) -> Outline:
    """The outer outline of the largest part of a silhouette, holes passed over, as `count` points."""
    mask = np.pad(silhouette_mask(image), 2).astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    longest = max(contours, key=lambda c: (cv2.contourArea(c), len(c)))[:, 0].astype(float) - 2
    if len(longest) < 3:
        longest = longest.mean(0) + 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    if _signed_area(longest) < 0:
        longest = longest[::-1]
    dense = _resample(longest, max(512, 4 * count))
    length = np.linalg.norm(np.diff(dense, axis=0, append=dense[:1]), axis=1).sum()
    share = max(_SMOOTHING, _SMOOTHING_PX / length)
    smooth = gaussian_filter1d(dense, share * len(dense), axis=0, mode="wrap")
    points = _resample(smooth, 8 * count)
    step = np.roll(points, -4, 0) - np.roll(points, 4, 0)
    return Outline(points[::8], np.arctan2(step[::8, 1], step[::8, 0]))


def mirrored(shape: Outline) -> Outline:
    """The outline seen in a mirror (x to -x), running clockwise again."""
    points = shape.points[::-1] * [-1.0, 1.0]
    return Outline(points, np.arctan2(-np.sin(shape.tangents[::-1]), np.cos(shape.tangents[::-1])))


def _signed_area(points: Floats) -> float:
    x, y = points.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _resample(closed: Floats, count: int) -> Floats:
    """A closed polyline (N, 2) at `count` points evenly by length (count, 2)."""
    ring = np.vstack([closed, closed[:1]])
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
    at = np.arange(count) * length[-1] / count
    return np.stack([np.interp(at, length, ring[:, k]) for k in (0, 1)], -1)
