"""Lessons as tensors: pictures, rays, and what the network should say of them."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.wall_network.pictures import Lesson
from ursnav_torch.camera import Camera
from ursnav_torch.features import DefaultSettings, LocalPlane
from ursnav_torch.features.flatten import blur, flatten, masked_blur
from ursnav_torch.features.network import CELL, FOREGROUND, lens_rays

#: Walls nearer than this to the camera are taken to be this far, mm.
_NEAREST_MM = 0.3


@dataclass(frozen=True, slots=True)
class Batch:
    """N pictures with their truth.

    Attributes:
        picture: (N, 3, S, S) uint8.
        rays: (N, 3, S, S) float16: x and y of the unit rays and the lens's mask.
        relief: (N, S, S) float16.
        rest: (N, 2 + 3, S / 4, S / 4) float16: log depth less its mean, 1.0 where a wall is,
            shares of foreground.
    """

    picture: Tensor
    rays: Tensor
    relief: Tensor
    rest: Tensor

    def __getitem__(self, rows: Tensor) -> "Batch":
        return Batch(self.picture[rows], self.rays[rows], self.relief[rows], self.rest[rows])

    def __len__(self) -> int:
        return len(self.picture)


def join(parts: list[Batch]) -> Batch:
    """Several batches in one."""
    return Batch(*(torch.cat([getattr(part, name) for part in parts]) for name in Batch.__slots__))


def batch_of(lesson: Lesson) -> Batch:
    """A lesson as tensors."""
    lenses: dict[tuple[float, ...], _Lens] = {}
    rays, relief, rest = [], [], []
    for row in range(len(lesson.picture)):
        key = tuple(lesson.lens[row])
        if key not in lenses:
            lenses[key] = _Lens(lesson.camera(row))
        lens = lenses[key]
        rays.append(lens.rays.half())
        relief.append(lens.relief(torch.from_numpy(lesson.clean[row])).half())
        depth, kind = torch.from_numpy(lesson.depth_mm[row]).float(), torch.from_numpy(lesson.kind[row]).long()
        rest.append(lens.rest(depth, kind).half())
    picture = torch.from_numpy(lesson.picture).permute(0, 3, 1, 2).contiguous()
    return Batch(picture, torch.stack(rays), torch.stack(relief), torch.stack(rest))


class _Lens:
    """What depends on the lens alone."""

    def __init__(self, camera: Camera) -> None:
        self.rays = lens_rays(camera)
        size = min(camera.width, camera.height)
        self._mask = (blur(self.rays[2], 1.0) > 0.99).float()
        self._blur = DefaultSettings().relief_blur * size
        self._around = LocalPlane(self._mask, DefaultSettings().relief_reach * size)

    def relief(self, clean: Tensor) -> Tensor:
        """The relief (S, S) of a clean view (S, S) as the extractor would give it."""
        log_image = masked_blur(torch.log(clean.float() + 8), self._mask, self._blur)
        return flatten(log_image, self._mask, self._around)

    def rest(self, depth_mm: Tensor, kind: Tensor) -> Tensor:
        """What is learned once a cell (5, S / 4, S / 4) from depth and kind (S, S)."""
        wall = (depth_mm > 0) & (self._mask > 0)
        log_depth = torch.where(wall, depth_mm.clamp_min(_NEAREST_MM).log(), 0.0)
        log_depth = (log_depth - (log_depth.sum() / wall.sum().clamp_min(1))) * wall
        share = _cells(wall.float())
        fore = functional.one_hot(kind, 1 + len(FOREGROUND)).permute(2, 0, 1)[1:].float()
        return torch.cat([(_cells(log_depth) / share.clamp_min(1e-3))[None], (share > 0.5).float()[None], _cells(fore)])


def _cells(x: Tensor) -> Tensor:
    """Means (..., h, w) over the cells of (..., H, W)."""
    return functional.avg_pool2d(x.reshape(-1, 1, *x.shape[-2:]), CELL).reshape(
        *x.shape[:-2], *(n // CELL for n in x.shape[-2:])
    )
