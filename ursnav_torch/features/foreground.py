"""Stones and instruments as regions: connected parts of the network's odds, each with a kind and a probability."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.measure import label, regionprops
from torch import Tensor

#: What becomes a region, in the order of the network's odds; clutter is too small and too many.
KINDS = ("stone", "instrument")
#: A region's pixels are at least this probable.
_EDGE = 0.4
#: A region is told when it is this probable; chosen by ``python -m benchmarks.wall_network.stones``.
SURE = 0.9
#: Share of the picture that a region covers at least.
_SMALLEST = 0.003
#: A large stone's region covers this share of the picture at least, is this probable on average, and fills this share
#: of its convex hull: clutter and folds of the wall do not. Set by hand on lessons of phantoms and on one exploration
#: past a stone that filled a fifth of the picture and more, and judged on no others: no command chose them.
#: `benchmarks.foreground data=DIR` finds with it what it found without.
_LARGE, _MEAN, _SOLID = 0.05, 0.9, 0.9
#: There may be one where pixels of as large a share are this probable in all.
_POSSIBLE = 0.05


@dataclass(frozen=True, slots=True)
class ForegroundBody:
    """A region before the wall.

    Attributes:
        kind: one of `KINDS`.
        probability: that there is such a body, 0 to 1: the mean of the surest quarter of its pixels.
        center_px: (2,) x and y of its middle, px of the picture.
        size_px: diameter of the circle of its area, px of the picture.
        share: of the picture that it covers, 0 to 1.
        mask: (h, w) bool, its pixels at the extractor's working size.
    """

    kind: str
    probability: float
    center_px: tuple[float, float]
    size_px: float
    share: float
    mask: NDArray[np.bool_]


def find_bodies(probability: Tensor, mask: Tensor, scale: float, sure: float = SURE) -> tuple[ForegroundBody, ...]:
    """Bodies in a picture, the largest first.

    Args:
        probability: (2, h, w) of each of `KINDS`.
        mask: (h, w) 1.0 inside the picture.
        scale: px of the picture a px here.
        sure: least probability of a body.
    """
    p, area = (probability * mask).numpy(), float(mask.sum())
    kinds = p.argmax(0)
    found = []
    for row, kind in enumerate(KINDS):
        if p[row].max() < sure:  # no region can be that sure
            continue
        for region in regionprops(label((p[row] > _EDGE) & (kinds == row), connectivity=2)):
            inside = np.zeros(p.shape[1:], bool)
            inside[tuple(region.coords.T)] = True
            values = np.sort(p[row][inside])
            surest = float(values[-max(1, len(values) // 4) :].mean())
            if surest >= sure and region.area >= _SMALLEST * area:
                y, x = ((c + 0.5) * scale - 0.5 for c in region.centroid)
                size = float(np.sqrt(4 * region.area / np.pi)) * scale
                found.append(
                    ForegroundBody(kind, surest, (float(x), float(y)), size, float(region.area / area), inside)
                )
    return tuple(sorted(found, key=lambda body: -body.share))


def may_be_large(probability: Tensor, mask: Tensor) -> bool:
    """Whether a large stone is possible by probabilities (h, w) of a stone within a mask (h, w)."""
    return bool((probability * mask > _POSSIBLE).sum() >= _LARGE * mask.sum())


def large_stones(probability: Tensor, mask: Tensor) -> Tensor:
    """The probabilities (h, w) of large stones, 0 elsewhere.

    Args:
        probability: (h, w) of a stone.
        mask: (h, w) 1.0 inside the picture.
    """
    p, least = (probability * mask).numpy(), _LARGE * float(mask.sum())
    told = np.zeros_like(p)
    if (p > _EDGE).sum() < least:
        return torch.from_numpy(told)
    for region in regionprops(label(p > _EDGE, connectivity=2)):
        at = tuple(region.coords.T)
        if region.area >= least and p[at].mean() >= _MEAN and region.solidity >= _SOLID:
            told[at] = p[at]
    return torch.from_numpy(told)
