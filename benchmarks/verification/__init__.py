"""Teaches the network that verifies poses and judges it: ``python -m benchmarks.verification work=DIR save=true``.

Hypotheses of simulated pictures are aligned as `match` aligns them; the network learns which of each picture's are
right from some phantoms, and is judged on others, beside the score of alignment alone, by kind of picture. Arguments,
each ``key=value``: ``work=DIR`` (keeps what was aligned; the same call goes on from there), ``phantoms=4``,
``kept_back=2``, ``pictures=16`` (of a kind and phantom), ``views=60`` (a calyx), ``epochs=8``, ``seed=0`` (the same
seed gives the same weights), ``save=false`` (with the package), ``out=FILE.json``.

Tried before and left, on 323 pictures of two phantoms (the first of three hypotheses is right by score in 70.6 %):
correlation of drawn and read log depth alone 58 %, its likelihood 55 %, correlation with the read relief 71 %; a
conditional logit of score, search distance and these, learned on the other phantom, 75 %, of twelve hypotheses 74 %.
More lessons of this kind teach it no more: by two phantoms 78.2 %, by four 78.8 % of 307 (negative log-likelihood
0.527 and 0.526); a right hypothesis is among the six in 91.5 %.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save

from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.verification.pictures import HYPOTHESES, ROUNDS, Lessons, lessons
from benchmarks.verification.train import case, first_is_right, train
from ursnav_torch.alignment import verification
from ursnav_torch.alignment.verification import WEIGHTS, VerificationNetwork

DEFAULTS = {
    "work": "", "phantoms": 4, "kept_back": 2, "pictures": 16, "views": 60, "epochs": 8, "seed": 0, "save": False,
    "out": "",
}  # fmt: skip
#: Seed of the first phantom learned from; those kept back follow the last one.
FIRST_SEED = 3100
_ROUND_NAMES = ("after the coarse round", "after a fine round")


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Align what is not aligned yet, teach, judge, write."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "what is aligned (about 40 MB a phantom)")
    torch.set_num_threads(1)
    last = FIRST_SEED + settings["phantoms"]
    network = train(_lessons(range(FIRST_SEED, last), settings, work), settings["epochs"], settings["seed"])
    if settings["save"]:
        write_weights(network, Path(verification.__file__).with_name(WEIGHTS))
    kept = _lessons(range(last, last + settings["kept_back"]), settings, work)
    report = Report("verification", {k: v for k, v in settings.items() if k not in ("work", "save", "out")})
    judge(report, network, kept)
    report.add("size", "weights", "of them", [sum(p.numel() for p in network.parameters())])
    report.finish(settings["out"])
    return 0


def judge(report: Report, network: VerificationNetwork, kept: Sequence[Lessons]) -> None:
    """How often the first hypothesis names the right calyx, by score and by the network, of three and of all."""
    for rounds in range(ROUNDS):
        for kind in ("all kinds", *np.unique(np.concatenate([own.kind for own in kept]))):
            rows = [(own, row) for own in kept for row in range(len(own)) if kind in ("all kinds", own.kind[row])]
            cases = [case(own, row, rounds) for own, row in rows]
            for most in (3, HYPOTHESES):
                for name, by in (("score", None), ("network", network)):
                    right = first_is_right(by, cases, most)
                    report.add(
                        f"right calyx first, {_ROUND_NAMES[rounds]}, {kind}", f"{name}, {most} hypotheses", "%",
                        [100 * float(np.mean(right))], n=len(right),
                    )  # fmt: skip


def write_weights(network: VerificationNetwork, path: Path) -> None:
    """Weights as safetensors, whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(save({name: value.contiguous() for name, value in network.state_dict().items()}))
    os.replace(partial, path)


def _lessons(seeds: range, settings: dict[str, int], work: Path) -> list[Lessons]:
    found = []
    for seed in seeds:
        found.append(lessons(seed, settings["pictures"], settings["views"], work))
        print(f"phantom {seed}: {len(found[-1])} pictures", file=sys.stderr, flush=True)
    return found
