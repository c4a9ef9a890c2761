"""What an extractor gives."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody

#: `Features.valid` of a picture in which nothing lies before the wall.
NOTHING_BEFORE = torch.zeros(0, 0)
#: `Features.read` of a picture that no network read.
NOTHING_READ = torch.zeros(0, 0, 0)


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """Points on the edges of one picture.

    Attributes:
        points: (N, 2) float32, x and y in px of the picture.
        direction: (N,) float32, the edge's own direction in radians, x towards y, in [0, pi): an edge has no head.
        weight: (N,) float32 in 0..1, how surely this is an edge.
    """

    points: Tensor
    direction: Tensor
    weight: Tensor

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, index: Tensor) -> "EdgePoints":
        """The points at ``index``, in that order."""
        return EdgePoints(self.points[index], self.direction[index], self.weight[index])


@dataclass(frozen=True, slots=True)
class Features:
    """One picture, ready to be matched.

    Attributes:
        edges: its sampled edge points.
        maps: (C, R, A) polar maps, the first the relief, the others pairs of edge directions; empty (0, 0, 0)
            for an extractor that compares points alone.
        edge_image: (H, W) bool, all edges before sampling, to be looked at.
        fields: (C, h, w) what the maps were sampled from, at the extractor's working size; empty without maps.
        contrast: log10 of the median local contrast (in log intensity) of coarse structure: low for a wall or a
            white-out.
        grain: how much more contrast (log10) fine structure has than coarse: high for noise. Both are 0 for a drawn
            view, of which nobody asks them.
        valid: (h, w) 0 to 1, how much of each pixel of the fields is wall; empty where nothing lies before it.
        bodies: stones and instruments before the wall, the largest first.
        read: (5, h, w) what the wall network read: the relief, its log variance, the log depth less a constant, its
            log variance, and the probability that nothing lies before the wall; empty for a drawn view.
    """

    edges: EdgePoints
    maps: Tensor
    edge_image: NDArray[np.bool_]
    fields: Tensor
    contrast: float = 0.0
    grain: float = 0.0
    valid: Tensor = NOTHING_BEFORE
    bodies: tuple[ForegroundBody, ...] = ()
    read: Tensor = NOTHING_READ


class Extractor(Protocol):
    """Reduces pictures of one lens to features.

    Attributes:
        working_camera: the lens at the working size, in which `Features.fields` are given.
    """

    working_camera: Camera

    def extract(self, image: NDArray[np.uint8], virtual: bool = False) -> Features:
        """Features of a picture (H, W) or (H, W, 3) blue, green, red; ``virtual`` marks a drawn, noiseless one.

        Raises:
            InputError: the picture cannot be of this lens.
            FeatureError: it shows too little to be matched.
        """
        ...


#: Maps and fields of an extractor that compares points alone.
NO_MAPS = torch.zeros(0, 0, 0)
#: Edge points of a picture that shows none, or in which nobody looked for them.
NO_EDGES = EdgePoints(torch.zeros(0, 2), torch.zeros(0), torch.zeros(0))
