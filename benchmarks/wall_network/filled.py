"""Teaches when to look at a picture once more for a stone that fills it: ``python -m benchmarks.wall_network.filled``.

A second look at a smaller picture tells stones that fill much of one, and costs more than half of the first. Logistic
regression on the means of the first look's coarsest channels foretells it, on pictures of phantoms through random
lenses with faults wider than the world, a near stone before the wall in two of three. The look is asked for where that
foretells it and the picture has more than one hue, or where the first look holds a large stone possible. It is judged
on phantoms kept back: of the pictures in which the second look tells a stone, in how many it is still asked for, and
in how many without one. Arguments, each ``key=value``: ``phantoms=4`` ``kept_back=2`` ``save=false`` (with the package)
``out=FILE.json``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from benchmarks.shared.results import Report, errors_told, overrides
from benchmarks.shared.statistics import wilson
from benchmarks.wall_network import stored, write_weights
from benchmarks.wall_network.pictures import PER_LENS, WIDE, faults_of, lens_of, places_in
from ursnav_torch.features import network as network_module
from ursnav_torch.features.foreground import may_be_large
from ursnav_torch.features.network import FILLED, WallReader, has_hues, lens_rays, packaged_network
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.rendering.sensor import STONE, Stone, simulate_labeled

DEFAULTS = {"phantoms": 4, "kept_back": 2, "save": False, "out": ""}
#: First seeds of the phantoms learned from, and of those kept back.
LEARNED_FROM, KEPT_BACK = 7200, 8200
#: Pictures of a phantom, and how strongly weights are held back.
PICTURES, HELD_BACK = 160, 5.0
_STEPS = 100


@dataclass(frozen=True, slots=True)
class Seen:
    """What the looks say of N pictures.

    Attributes:
        mean: (N, C) the first look's coarsest channels.
        possible: (N,) bool, whether it holds a large stone possible.
        hued: (N,) bool, whether the picture has more than one hue.
        told: (N,) bool, whether the second look tells one.
        stone: (N,) share of the picture that is stone.
        phantom: (N,) seed.
    """

    mean: Tensor
    possible: Tensor
    hued: Tensor
    told: Tensor
    stone: Tensor
    phantom: Tensor

    def at(self, rows: Tensor) -> "Seen":
        """Some of them, by mask (N,)."""
        return Seen(*(getattr(self, name)[rows] for name in self.__slots__))


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Look, teach, judge, write."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(1)
    learned = looks(range(LEARNED_FROM, LEARNED_FROM + settings["phantoms"]))
    kept = looks(range(KEPT_BACK, KEPT_BACK + settings["kept_back"]))
    report = Report("wall_network_filled", {k: settings[k] for k in ("phantoms", "kept_back")})
    judge(report, "phantoms taught, each by what the others teach", learned, crossed(learned))
    network = stored()
    weight = taught(learned)
    network.filled.weight.data, network.filled.bias.data = weight[None, :-1].clone(), weight[-1:].clone()
    judge(report, "phantoms kept back", kept, logits(weight, kept.mean))
    if settings["save"]:
        write_weights(network)
    report.finish(settings["out"])
    return 0


@torch.inference_mode()
def looks(seeds: Sequence[int]) -> Seen:
    """Both looks at the pictures of some phantoms."""
    rows = [row for seed in seeds for row in _look(seed)]
    mean, *others = zip(*rows, strict=True)
    return Seen(torch.stack(mean), *map(torch.tensor, others))


def _look(seed: int) -> list[tuple[Tensor, bool, bool, bool, float, int]]:
    rng, kidney = np.random.default_rng(seed), make_phantom_kidney(seed)
    places, network, rows = places_in(kidney, seed), packaged_network(), []
    for number, view in enumerate(rng.permutation(len(places))[:PICTURES]):
        if number % PER_LENS == 0:
            renderer = lens_of(kidney, rng)
            camera, rays = renderer.camera, lens_rays(renderer.camera)
            reader = WallReader(camera, rays[2])
        T = places[view]
        stones = (near_stone(T, rng),) if number % 3 else ()
        shown = simulate_labeled(renderer.render(T), camera, T, faults_of(rng, WIDE), rng, stones)
        picture = torch.from_numpy(shown.image).permute(2, 0, 1)[None].float()
        _, odds, mean = network.channels(picture, rays[None])
        stone = functional.interpolate(odds[:, :1], scale_factor=network_module.CELL, mode="bilinear")[0, 0].sigmoid()
        share = float((shown.kind == STONE).sum() / rays[2].sum())
        told = bool(reader.again(shown.image).any())
        rows.append((mean[0], may_be_large(stone, rays[2]), has_hues(shown.image), told, share, seed))
    return rows


def near_stone(T: NDArray[np.float64], rng: np.random.Generator) -> Stone:
    """A stone before a camera (4, 4) that fills a good part of its picture."""
    center = T[:3, 3] + T[:3, :3] @ [*rng.uniform(-1.5, 1.5, 2), rng.uniform(3.2, 6.5)]
    color = np.array([0.55, 0.75, 0.85]) * rng.uniform(0.6, 1.1) * rng.uniform(0.9, 1.1, 3)
    radii = rng.uniform(2.2, 3.4) * rng.uniform(0.8, 1.2, 3)
    return Stone(center, radii, np.eye(3), (float(color[0]), float(color[1]), float(color[2])), 0.1, 1)


def taught(seen: Seen) -> Tensor:
    """Weights (C + 1,) by which the second look is foretold, both answers counting alike."""
    told, mean = seen.told, seen.mean.clone()
    middle, size = mean.mean(0), mean.std(0) + 1e-6
    x = torch.cat([(mean - middle) / size, torch.ones(len(mean), 1)], 1)
    share = torch.where(told, 0.5 * len(told) / told.sum(), 0.5 * len(told) / (~told).sum())
    with torch.inference_mode(False):
        x, share, sign = x.clone(), share.clone(), torch.where(told, 1.0, -1.0)
        w = torch.zeros(x.shape[1], requires_grad=True)
        optimizer = torch.optim.LBFGS([w], max_iter=_STEPS, line_search_fn="strong_wolfe")

        def loss() -> Tensor:
            optimizer.zero_grad()
            found = (share * functional.softplus(-sign * (x @ w))).sum() + HELD_BACK / 2 * w[:-1].square().sum()
            found.backward()
            return found

        optimizer.step(loss)
    found = w.detach()
    return torch.cat([found[:-1] / size, found[-1:] - (found[:-1] * middle / size).sum()[None]])


def logits(weight: Tensor, mean: Tensor) -> Tensor:
    """Of pictures (N,) by weights (C + 1,)."""
    return mean @ weight[:-1] + weight[-1]


def crossed(seen: Seen) -> Tensor:
    """Logits of pictures (N,), each by what the other phantoms teach."""
    found = torch.zeros(len(seen.told))
    for seed in seen.phantom.unique():
        own = seen.phantom == seed
        found[own] = logits(taught(seen.at(~own)), seen.mean[own])
    return found


def judge(report: Report, group: str, seen: Seen, found: Tensor) -> None:
    """How often the second look is asked for."""
    asked, none = seen.possible | (seen.hued & (found >= FILLED)), seen.stone == 0
    for what, these in (
        ("with a stone that it tells", seen.told),
        ("of these, without the first look's word", seen.told & ~seen.possible),
        ("without any stone", none),
    ):
        count, of = int((asked & these).sum()), int(these.sum())
        low, high = wilson(count, of) if of else (0.0, 1.0)
        note = f"{count}/{of}, 95 % interval {100 * low:.0f} to {100 * high:.0f} %"
        report.add(group, f"second look asked for, pictures {what}", "%", [100 * count / max(of, 1)], note, max(of, 1))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
