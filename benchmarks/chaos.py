"""Every runner killed, stopped, doubled, without disk and with another clock: is a result ever half, or lost?

    python -m benchmarks.chaos kills=200
    python -m benchmarks.chaos kills=20 only=match

For each runner a small job is done once undisturbed. Then it is started again and again and killed (SIGKILL) at a
random moment; what stands then must be what the undisturbed one made, or nothing, and the same call must end in the
same bytes (but for columns that tell times). So it must after a stop (SIGSTOP) with the same call beside it, two calls
at once, a disk that is full at a random size, and clocks that jump. Exit code 1 where it does not hold.
"""

import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.disturbing.children import kill, results, said, start, wait
from benchmarks.disturbing.jobs import Job, jobs, make_inputs
from benchmarks.shared.results import overrides

SETTINGS = {"kills": 20, "others": 4, "seed": 0, "only": "", "minutes": 0.0}
_REFUSALS = ("is being written by", "exists already")


def main(arguments: list[str]) -> int:
    """Disturb all runners; print what came of it."""
    settings = overrides(SETTINGS, arguments)
    _import_all()
    faults = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        make_inputs_apart(folder / "inputs")
        for job in jobs(folder / "inputs"):
            if str(settings["only"]) in job.runner:
                faults += _disturbed(job, folder, settings)
    return int(faults > 0)


def make_inputs_apart(folder: Path) -> None:
    """`make_inputs` in a child: this process starts no thread, so that it can be forked."""
    import os

    child = os.fork()
    if child == 0:
        code = 1
        try:
            make_inputs(folder, lambda job, where: wait(start(job, where)))
            code = 0
        finally:
            os._exit(code)
    if wait(child):
        raise RuntimeError("the inputs could not be made")


def _import_all() -> None:
    """Import what the runners import, once for all children."""
    from importlib import import_module

    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    for name in (
        "runs.match",
        "runs.track",
        "runs.register",
        "thesis",
        "segmentation",
        "printing",
        "vid",
        "calibration",
    ):
        import_module(f"ursnav_torch.{name}")


def _disturbed(job: Job, folder: Path, settings: dict[str, Any]) -> int:
    """Disturb one runner; the number of faults."""
    rng = random.Random(f"{settings['seed']}/{job.runner}")
    begin = time.monotonic()
    whole, took = _undisturbed(job, folder)
    count: Counter[str] = Counter()
    faults: list[str] = []
    for disturb, times in ((_killed, settings["kills"]), (_stopped, settings["others"]), (_doubled, settings["others"]),
                           (_full, settings["others"]), (_clock, settings["others"])):  # fmt: skip
        for _ in range(int(times)):
            if settings["minutes"] and time.monotonic() - begin > 60 * float(settings["minutes"]):
                break
            here = Path(tempfile.mkdtemp(dir=folder))
            fault = disturb(job, here, whole, rng, took)
            count[disturb.__name__.strip("_")] += 1
            if fault:
                faults.append(f"{disturb.__name__.strip('_')}: {fault}")
            shutil.rmtree(here)
    print(f"{job.runner:14} {took:5.1f} s undisturbed  {dict(count)}  {len(faults)} faults", flush=True)
    for fault in faults[:10]:
        print(f"    {fault}", flush=True)
    return len(faults)


def _undisturbed(job: Job, folder: Path) -> tuple[dict[str, Any], float]:
    here = folder / f"whole_{job.runner}"
    here.mkdir()
    begin = time.monotonic()
    child = start(job, here)
    if wait(child) not in job.codes:
        raise RuntimeError(f"{job.runner} cannot even be done undisturbed: {said(child, here)}")
    return results(job, here), time.monotonic() - begin


def _fault(job: Job, here: Path, whole: dict[str, Any], what: str) -> str:
    """How the results that stand differ from the whole ones; blank where they do not, or none stands."""
    found = results(job, here)
    wrong = sorted(name for name in found if found[name] != whole.get(name))
    if wrong:
        return f"{what}: {', '.join(wrong[:3])} is not what it should be"
    first = [name for name in whole if name == job.out or name.startswith(job.out + "/")]
    if any(name in found for name in first) and found.keys() != whole.keys():
        return f"{what}: {job.out} stands, but {', '.join(sorted(whole.keys() - found.keys())[:3])} is missing"
    return ""


def _ended(job: Job, here: Path, whole: dict[str, Any], what: str) -> str:
    """The same call once more: it ends it, or says that the result stands."""
    stood = results(job, here).keys() == whole.keys()
    child = start(job, here)
    code, text = wait(child), said(child, here)
    if code not in job.codes and not (stood and "exists already" in text):
        return f"{what}, the same call ends with {code}: {text[-300:]}"
    if results(job, here) != whole:
        return f"{what}, the same call ends in other bytes. " + _fault(job, here, whole, what)
    left = [p.name for p in here.iterdir() if p.suffix != ".log" and p.name not in (job.out, *job.besides)]
    return f"{what}: {left} is left behind" if [n for n in left if not n.endswith((".lock", ".partial"))] else ""


def _killed(job: Job, here: Path, whole: dict[str, Any], rng: random.Random, took: float) -> str:
    child, after = start(job, here), rng.uniform(0, 1.1 * took)
    time.sleep(after)
    kill(child)
    wait(child)
    what = f"killed after {after:.2f} s"
    return _fault(job, here, whole, what) or _ended(job, here, whole, what)


def _stopped(job: Job, here: Path, whole: dict[str, Any], rng: random.Random, took: float) -> str:
    """Stopped, the same call beside it, and going on."""
    first, after = start(job, here), rng.uniform(0, took)
    time.sleep(after)
    kill(first, signal.SIGSTOP)
    second = start(job, here)
    code = wait(second)
    kill(first, signal.SIGCONT)
    return _both(job, here, whole, {first: wait(first), second: code}, f"stopped after {after:.2f} s")


def _doubled(job: Job, here: Path, whole: dict[str, Any], rng: random.Random, took: float) -> str:
    """Two at once."""
    children = [start(job, here), start(job, here)]
    return _both(job, here, whole, {child: wait(child) for child in children}, "two at once")


def _both(job: Job, here: Path, whole: dict[str, Any], codes: dict[int, int], what: str) -> str:
    if not any(code in job.codes for code in codes.values()):
        return f"{what}: none came to its end: " + "; ".join(said(child, here)[-200:] for child in codes)
    for child, code in codes.items():
        if code not in job.codes and not any(text in said(child, here) for text in _REFUSALS):
            return f"{what}: one ended with {code}: {said(child, here)[-300:]}"
    if sum(code in job.codes for code in codes.values()) > 1:
        return f"{what}: both say that they made it"
    return "" if results(job, here) == whole else _fault(job, here, whole, what) or f"{what}: results are missing"


def _full(job: Job, here: Path, whole: dict[str, Any], rng: random.Random, took: float) -> str:
    """A disk with room for files of some size only."""
    room = int(rng.choice((0, 1, 100, 1000, 10_000)) * rng.uniform(1, 10))
    child = start(job, here, room=room)
    code, text = wait(child), said(child, here)
    what = f"files of {room} bytes at most"
    if code not in job.codes and "Traceback" in text:
        return f"{what}: no sentence: {text[-300:]}"
    return _fault(job, here, whole, what) or _ended(job, here, whole, what)


def _clock(job: Job, here: Path, whole: dict[str, Any], rng: random.Random, took: float) -> str:
    """Killed under one clock, ended under another."""
    child = start(job, here, clock_s=rng.uniform(-1e8, 1e8))
    time.sleep(rng.uniform(0, took))
    kill(child)
    wait(child)
    return _ended(job, here, whole, "the clock jumped")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
