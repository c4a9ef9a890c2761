"""Training: AdamW under a cosine schedule, a fixed number of pictures, one seed; the same threads, the same weights."""

import sys
import time
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.wall_network.targets import Batch
from ursnav_torch.features.network import CELL, WallNetwork, WallReading

BATCH, WARM_UP, DECAY = 24, 60, 1e-3
LARGEST_GRADIENT = 5.0
#: Weights of the parts of `losses`.
WEIGHT = {"relief": 1.0, "depth": 0.5, "depth edges": 1.5, "foreground": 1.0, "overlap": 0.5}
_REPORT_EVERY = 250
Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Losses:
    """Parts of the loss, each a scalar."""

    relief: Tensor
    depth: Tensor
    depth_edges: Tensor
    foreground: Tensor
    overlap: Tensor

    def total(self) -> Tensor:
        """Their weighted sum."""
        return sum(WEIGHT[name.replace("_", " ")] * value for name, value in self.items().items())  # type: ignore[return-value]

    def items(self) -> dict[str, Tensor]:
        """By name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


def losses(found: WallReading, truth: Batch) -> Losses:
    """Gaussian likelihood of relief and log depth, the latter's slopes, cross entropy and overlap of foreground."""
    rest = truth.rest.float()
    log_depth, wall = rest[:, 0], rest[:, 1]
    variance = _at_full_size(found.log_variance.clamp(-4, 3))
    relief = _gaussian(found.relief - truth.relief.float(), variance, _at_full_size(wall))
    count = wall.sum((1, 2)).clamp_min(1)
    centered = found.log_depth - ((found.log_depth * wall).sum((1, 2)) / count)[:, None, None]
    likely = _gaussian(centered - log_depth, found.depth_log_variance.clamp(-6, 2), wall)
    return Losses(relief, likely, _edges(centered - log_depth, wall), *foreground_losses(found.odds, truth))


def foreground_losses(odds: Tensor, truth: Batch) -> tuple[Tensor, Tensor]:
    """Cross entropy and overlap of logits (N, 3, h, w) of what lies before the wall."""
    rest = truth.rest.float()
    wall, fore = rest[:, 1], rest[:, 2:]
    cross = functional.binary_cross_entropy_with_logits(odds, fore, reduction="none") * wall[:, None]
    return cross.sum() / wall.sum().clamp_min(1), _overlap(odds, fore, wall)


def _at_full_size(x: Tensor) -> Tensor:
    """Cells (N, h, w) as pixels (N, H, W)."""
    return functional.interpolate(x[:, None], scale_factor=float(CELL))[:, 0]


def _gaussian(residual: Tensor, log_variance: Tensor, where: Tensor) -> Tensor:
    loss = residual.square() * (-log_variance).exp() + log_variance
    return (loss * where).sum() / where.sum().clamp_min(1)


def _edges(residual: Tensor, wall: Tensor) -> Tensor:
    """Mean size of a residual's steps from pixel to pixel (N, H, W): what contours are made of."""
    along, down = residual.diff(dim=2).abs(), residual.diff(dim=1).abs()
    along, down = along * wall[:, :, 1:] * wall[:, :, :-1], down * wall[:, 1:] * wall[:, :-1]
    return (along.sum() + down.sum()) / wall.sum().clamp_min(1)


def _overlap(odds: Tensor, fore: Tensor, wall: Tensor) -> Tensor:
    """1 less each kind's soft Dice overlap over the batch (Milletari et al., 3DV 2016), so that small ones count."""
    p = odds.sigmoid() * wall[:, None]
    both, either = (p * fore).sum((0, 2, 3)), (p + fore * wall[:, None]).sum((0, 2, 3))
    return (1 - (2 * both + 1) / (either + 1)).mean()


def train(
    network: WallNetwork, lessons: Batch, kept_back: Batch, pictures: int, rate: float, seed: int, threads: int
) -> WallNetwork:
    """The network taught by ``pictures`` random picks from the lessons, each turned, mirrored and tinted anew."""
    torch.set_num_threads(threads)
    rng = np.random.default_rng(seed)
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=DECAY)
    steps, began = pictures // BATCH, time.monotonic()
    order = np.concatenate([rng.permutation(len(lessons)) for _ in range(pictures // len(lessons) + 1)])
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = rate * min(1, (step + 1) / WARM_UP) * (0.5 + 0.5 * np.cos(np.pi * step / steps)) + 1e-5
        rows = torch.from_numpy(order[step * BATCH : (step + 1) * BATCH])
        picture, rays, truth = varied(lessons[rows], rng)
        network.train()
        loss = losses(network(picture, rays), truth).total()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
        optimizer.step()
        if (step + 1) % _REPORT_EVERY == 0 or step + 1 == steps:
            told = " ".join(f"{name} {value:.3f}" for name, value in validate(network, kept_back).items())
            print(
                f"{step + 1} of {steps}, {time.monotonic() - began:.0f} s, kept back: {told}",
                file=sys.stderr,
                flush=True,
            )
    return network.eval()


def validate(network: WallNetwork, kept_back: Batch) -> dict[str, float]:
    """The parts of the loss on pictures that nothing was learned from."""
    network.eval()
    with torch.inference_mode():
        found = losses(network(kept_back.picture.float(), kept_back.rays.float()), kept_back)
    return {name: float(value) for name, value in found.items().items()}


def varied(batch: Batch, rng: Rng) -> tuple[Tensor, Tensor, Batch]:
    """A batch turned by quarter turns, mirrored, its colors mixed: pictures and rays (N, 3, S, S), and the truth."""
    quarter, mirror = int(rng.integers(4)), rng.random() < 0.5
    x, rays, relief, rest = batch.picture.float(), batch.rays.float(), batch.relief, batch.rest
    if mirror:
        x, rays, relief, rest = (v.flip(-1) for v in (x, rays, relief, rest))
        rays = rays * torch.tensor([-1.0, 1.0, 1.0])[:, None, None]
    x, rays, relief, rest = (torch.rot90(v, quarter, (-2, -1)) for v in (x, rays, relief, rest))
    for _ in range(quarter):  # a place's x and y turn with it
        rays = torch.stack([rays[:, 1], -rays[:, 0], rays[:, 2]], 1)
    if rng.random() < 0.5:
        x = x[:, torch.from_numpy(rng.permutation(3))]
    x = (x * torch.from_numpy(rng.uniform(0.8, 1.2, (len(x), 3, 1, 1)).astype(np.float32))).clamp(0, 255)
    return x, rays, Batch(x, rays, relief, rest)
