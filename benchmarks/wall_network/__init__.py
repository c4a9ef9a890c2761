"""Teaches the network that reads walls and writes its weights: ``python -m benchmarks.wall_network work=DIR``.

It learns from simulated pictures of phantoms alone, most of them of the preset `WIDE`; phantoms with other seeds are
kept back. Arguments, each ``key=value``: ``work=DIR`` (keeps what was drawn; the same call goes on from there),
``phantoms=32``, ``kept_back=2``, ``pictures=120000`` (samples of the training), ``rate=0.003`` (of learning, at most),
``seed=0``, ``threads=2`` (the same seed and threads give the same weights), ``workers=2`` (processes that draw),
``start=FILE`` (weights to go on from, ``packaged`` for the package's own; new ones when empty), ``weights=FILE``
(written; ``packaged`` when empty), ``out=FILE.json``.

The package's weights: ``phantoms=32`` from new ones, ``python -m benchmarks.wall_network.before save=true``, all of
them on from there by ``phantoms=128 kept_back=4 pictures=144000 rate=0.002 start=packaged threads=1``, and ``python
-m benchmarks.wall_network.filled save=true``. The third step brought the loss on four phantoms kept back from -1.02
to -1.12 for the relief and from -2.08 to -2.35 for log depth, and taught more of what lies before the wall (see
`before`). Answers gained little: 353 instead of 352 of 452 stills of four phantoms are right (``python -m
benchmarks.causes phantoms=2 first=0``, and 12), of 56 path-traced ones 50 instead of 48. A larger share of the
network in the relief does not help: of two phantoms' stills 576 of 648 are right with 0.3, 564 with 0.55, 553 with
0.8 (``.share phantoms=2 pictures=36 vary=learned=0.3,0.55,0.8``). Left, by code that is not kept: the mean of four
mirrored readings, 171 instead of 174 of 221.
"""

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import torch
from safetensors.torch import load, save

from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.wall_network.pictures import lesson
from benchmarks.wall_network.targets import Batch, batch_of, join
from benchmarks.wall_network.train import train, validate
from ursnav_torch.features import network as network_module
from ursnav_torch.features.network import WEIGHTS, WallNetwork

DEFAULTS = {
    "work": "", "phantoms": 32, "kept_back": 2, "pictures": 120_000, "rate": 3e-3, "seed": 0, "threads": 2,
    "workers": 2, "start": "", "weights": "", "out": "",
}  # fmt: skip
#: The package's own weights.
PACKAGED = Path(network_module.__file__).with_name(WEIGHTS)
#: First seeds of the phantoms learned from, and of those kept back.
LEARNED_FROM, KEPT_BACK = 7000, 8000


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Draw what is not drawn yet, teach, judge, write."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the pictures drawn (about 20 MB a phantom)")
    learned = range(LEARNED_FROM, LEARNED_FROM + settings["phantoms"])
    kept = range(KEPT_BACK, KEPT_BACK + settings["kept_back"])
    draw([*learned, *kept], work, settings["workers"])
    lessons, kept_back = taken(learned, work), taken(kept, work)
    torch.manual_seed(settings["seed"])
    network = stored(_file(settings["start"])) if settings["start"] else WallNetwork()
    network = train(
        network, lessons, kept_back, settings["pictures"], settings["rate"], settings["seed"], settings["threads"]
    )
    where = _file(settings["weights"] or "packaged")
    write_weights(network, where)
    report = Report("wall_network", {k: v for k, v in settings.items() if k not in ("work", "weights", "out")})
    for name, value in validate(network, kept_back).items():
        report.add("phantoms kept back, loss", name.replace("_", " "), "of 1", [value], n=len(kept_back))
    report.add("size", "weights", "of them", [sum(p.numel() for p in network.parameters())])
    report.add("size", "file", "kB", [where.stat().st_size / 1e3])
    print(f"weights: {where}")
    report.finish(settings["out"])
    return 0


def draw(seeds: Sequence[int], work: Path, workers: int) -> None:
    """Draw the lessons of phantoms that the folder does not hold."""
    missing = [seed for seed in seeds if not (work / f"{seed}.npz").exists()]
    with ProcessPoolExecutor(max(workers, 1), mp_context=get_context("spawn")) as pool:
        for done, _ in enumerate(pool.map(_drawn, missing, [work] * len(missing))):
            print(f"drawn {done + 1} of {len(missing)} phantoms", file=sys.stderr, flush=True)


def _drawn(seed: int, work: Path) -> None:
    lesson(seed, work)


def taken(seeds: Sequence[int], work: Path, crowded: bool = False) -> Batch:
    """The lessons of several phantoms as one batch."""
    parts = []
    torch.set_num_threads(1)  # a picture at a time is too little to share
    for seed in seeds:
        found = lesson(seed, work, crowded)
        if found is not None:
            parts.append(batch_of(found))
    return join(parts)


def _file(name: str) -> Path:
    return PACKAGED if name == "packaged" else Path(name)


def stored(path: Path = PACKAGED) -> WallNetwork:
    """The network with the weights of a file."""
    network = WallNetwork()
    network.load_state_dict({name: value.float() for name, value in load(path.read_bytes()).items()})
    return network.eval()


def write_weights(network: WallNetwork, path: Path = PACKAGED) -> None:
    """Weights in half precision, as safetensors, whole or not at all."""
    state = {
        name: value.half().contiguous() for name, value in network.state_dict().items() if value.is_floating_point()
    }
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(save(state))
    os.replace(partial, path)
