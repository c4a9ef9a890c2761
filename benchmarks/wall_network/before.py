"""Teaches the network's branch for what lies before the wall: ``python -m benchmarks.wall_network.before work=DIR``.

The wall is read as before: only the branch learns, half from pictures most of which show stones and an instrument,
half from those that the whole network learned from. It is judged on phantoms kept back: how much of each stone and
instrument that covers a hundredth of the picture or more is told, and how much of what is told is one. Arguments,
each ``key=value``: ``work=DIR`` (the lessons, drawn where they are not there), ``phantoms=12`` ``crowded=7``
``kept_back=1`` ``pictures=16800`` (samples of the training; with 0 the package's own is judged) ``seed=0``
``save=false`` (with the package) ``out=FILE.json``.

On one phantom kept back (median share told of large stones and instruments; share of what is told that is one): odds
as channels of the network's head 53 and 65 %; 84 and 72 %. A branch over the network's last and finest channels 65 and
70 %; 80 and 67 %. The same with how hues differ from the picture's own 72 and 82 %; 83 and 78 %.
The rest of the network in the package was taught with the odds as channels of its head first, and then all of it on
as `benchmarks.wall_network` says. With ``kept_back=2 pictures=0`` 70 and 83 %, 82 and 76 % before that; 76 and 86 %,
82 and 82 % since, and in 95 and 99 % of the pictures without one nothing is told instead of in 92 and 93 %.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.wall_network import LEARNED_FROM, stored, taken, write_weights
from benchmarks.wall_network.targets import Batch, join
from benchmarks.wall_network.train import BATCH, WARM_UP, foreground_losses, varied
from ursnav_torch.features.network import FOREGROUND, WallNetwork

DEFAULTS = {
    "work": "", "phantoms": 12, "crowded": 7, "kept_back": 1, "pictures": 16_800, "seed": 0, "save": False, "out": "",
}  # fmt: skip
#: First seeds of the crowded phantoms learned from, and of those kept back.
CROWDED_FROM, CROWDED_KEPT_BACK = 7100, 8100
RATE, DECAY = 4e-3, 1e-3
#: Least share of the picture of a body that counts, and how probable its pixels are.
LARGE, PROBABLE = 0.01, 0.4
_REPORT_EVERY = 100


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Teach, judge, write."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the lessons (about 20 MB a phantom)")
    torch.set_num_threads(1)
    report = Report("wall_network_before", {k: v for k, v in settings.items() if k not in ("work", "save", "out")})
    kept = range(CROWDED_KEPT_BACK, CROWDED_KEPT_BACK + settings["kept_back"])
    kept_back = taken(kept, work, crowded=True)
    network = _taught(settings, work) if settings["pictures"] else stored()
    judge(report, network, kept_back)
    if settings["save"]:
        write_weights(network)
    report.finish(settings["out"])
    return 0


def _taught(settings: dict[str, Any], work: Path) -> WallNetwork:
    plain = range(LEARNED_FROM, LEARNED_FROM + settings["phantoms"])
    crowded = range(CROWDED_FROM, CROWDED_FROM + settings["crowded"])
    network = untaught(settings["seed"])
    lessons, many = taken(plain, work), taken(crowded, work, crowded=True)
    teach(network, lessons, many, settings["pictures"], settings["seed"])
    return network


def untaught(seed: int) -> WallNetwork:
    """The network with the package's weights and a new branch."""
    torch.manual_seed(seed)
    network = WallNetwork()
    new = {name: value.half().float() for name, value in network.before.state_dict(prefix="before.").items()}
    network.load_state_dict(stored().state_dict() | new)
    return network.eval()


def teach(network: WallNetwork, lessons: Batch, crowded: Batch, pictures: int, seed: int) -> None:
    """Teach the branch from random picks, half of them crowded; the rest of the network stays as it is."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network.requires_grad_(False).eval()
    branch = network.before.requires_grad_(True)
    optimizer = torch.optim.AdamW(branch.parameters(), RATE, weight_decay=DECAY)
    steps, total = pictures // BATCH, 0.0
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, (step + 1) / WARM_UP) * (0.5 + 0.5 * np.cos(np.pi * step / steps)) + 1e-5
        half = BATCH // 2
        rows = [torch.from_numpy(rng.integers(len(of), size=half)) for of in (lessons, crowded)]
        picture, rays, truth = varied(join([lessons[rows[0]], crowded[rows[1]]]), rng)
        cross, overlap = foreground_losses(network(picture, rays).odds, truth)
        loss = cross + overlap
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        total += float(loss.detach())
        if (step + 1) % _REPORT_EVERY == 0:
            print(f"{step + 1} of {steps}: loss {total / _REPORT_EVERY:.3f}", file=sys.stderr, flush=True)
            total = 0.0


def judge(report: Report, network: WallNetwork, kept_back: Batch) -> None:
    """How much of each kind is told, and how much of what is told is of that kind."""
    with torch.inference_mode():
        odds = torch.cat(
            [
                network(kept_back.picture[rows].float(), kept_back.rays[rows].float()).odds
                for rows in torch.arange(len(kept_back)).split(BATCH)
            ]
        )
    told, wall = odds.sigmoid() > PROBABLE, kept_back.rest[:, 1] > 0
    for row, kind in enumerate(FOREGROUND[:2]):
        there, found = kept_back.rest[:, 2 + row].float(), told[:, row] & wall
        sizeable = there.mean((1, 2)) >= LARGE
        shares = (found * there).sum((1, 2))[sizeable] / there[sizeable].sum((1, 2))
        report.add(kind, "of each that is large, told", "%", (100 * shares).tolist(), n=len(shares))
        report.add(kind, "of all that is told, such", "%", [100 * _precision(found, there)], n=int(found.sum()))
        empty = there.amax((1, 2)) == 0
        quiet = float((found.float().mean((1, 2)) < LARGE / 3)[empty].float().mean())
        report.add(kind, "pictures without, nothing told", "%", [100 * quiet], n=int(empty.sum()))


def _precision(found: Tensor, there: Tensor) -> float:
    return float((found * there).sum() / found.sum().clamp_min(1))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
