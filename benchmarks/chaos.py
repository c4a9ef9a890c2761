"""Every runner killed, stopped, doubled, without disk and with another clock: is a result ever half, or lost?

    python -m benchmarks.chaos kills=200
    python -m benchmarks.chaos kills=20 only=match

For each runner a small job is done once undisturbed. Then it is started again and again and killed (SIGKILL) at a
random moment; what stands then must be what the undisturbed one made, or nothing, and the same call must end in the
same bytes (but for columns that tell times). So it must after a stop (SIGSTOP) with the same call beside it, two calls
at once, a disk that is full at a random size, and clocks that jump. Exit code 1 where it does not hold.

A call is forked from a process that has imported all and composed its configuration; what only computes is remembered
(``remember=false`` computes all anew), so that the moments spread over what touches files. ``out=`` keeps the figures.
"""

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.disturbing.children import Call, first_run, kill, results, said, start, wait
from benchmarks.disturbing.jobs import Job, jobs, make_inputs
from benchmarks.disturbing.remember import remember
from benchmarks.shared.results import Report, overrides

SETTINGS = {"kills": 20, "others": 4, "seed": 0, "only": "", "minutes": 0.0, "remember": True, "out": "-"}
#: Views drawn in one go: a small VID must have several shards, or nothing is ever resumed.
SHARD = 10
#: How the sentence begins that tells of a result which reads as whole and is not.
HALF = "half:"
_REFUSALS = ("is being written by", "exists already")


@dataclass(slots=True)
class Scene:
    """A runner's job that was done once undisturbed, and is done again and again.

    Attributes:
        job: what is done.
        call: how, from then on.
        whole: the results, by name.
        took_s: how long the undisturbed run took, in a child like those that are killed.
    """

    job: Job
    call: Call
    whole: dict[str, Any]
    took_s: float = 0.0


@dataclass(slots=True)
class Tally:
    """What came of a runner: how often it was disturbed in which way, when it was killed, and the faults."""

    runner: str
    took_s: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    half: int = 0
    faults: list[str] = field(default_factory=list)


def main(arguments: list[str]) -> int:
    """Disturb all runners; print and keep what came of it."""
    settings = overrides(SETTINGS, arguments)
    _import_all()
    tallies = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        apart(lambda: _make_inputs(folder / "inputs"))
        for job in jobs(folder / "inputs"):
            if str(settings["only"]) in job.runner:
                tallies.append(Tally(**apart(partial(_disturbed, job, folder, settings))))
                _tell(tallies[-1])
    if settings["out"] != "-":
        _report(settings, tallies).finish(str(settings["out"]))
    return int(any(tally.faults for tally in tallies))


def apart(work: Callable[[], Any]) -> Any:
    """Plain data that some work gives, done in a child: this process starts no thread, so that it can be forked.

    Raises:
        RuntimeError: the work failed; the child has said why.
    """
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.write(write_end, json.dumps(work()).encode())
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(write_end)
    with open(read_end, "rb") as pipe:
        told = pipe.read()
    if wait(child):
        raise RuntimeError("a part of the suite failed, see above")
    return json.loads(told)


def _make_inputs(folder: Path) -> None:
    def run(job: Job, where: Path) -> int:
        return first_run(job, where)[1]

    make_inputs(folder, run)


def _import_all() -> None:
    """Import what the runners import, once for all children."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    rooms = ("runs.match", "runs.track", "runs.register", "thesis", "segmentation", "printing", "vid", "calibration")
    for name in rooms:
        import_module(f"ursnav_torch.{name}")
    setattr(import_module("ursnav_torch.vid.build"), "SHARD", SHARD)  # noqa: B010


def _disturbed(job: Job, folder: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Disturb one runner; its tally as plain data."""
    rng = random.Random(f"{settings['seed']}/{job.runner}")
    begin, tally = time.monotonic(), Tally(job.runner)
    if settings["remember"]:
        remember()
    scene = _undisturbed(job, folder)
    tally.took_s = scene.took_s
    for disturb, times in ((_killed, settings["kills"]), (_stopped, settings["others"]), (_doubled, settings["others"]),
                           (_full, settings["others"]), (_clock, settings["others"])):  # fmt: skip
        for _ in range(int(times)):
            if settings["minutes"] and time.monotonic() - begin > 60 * float(settings["minutes"]):
                break
            here = Path(tempfile.mkdtemp(dir=folder))
            fault, name = disturb(scene, here, rng), disturb.__name__.strip("_")
            tally.counts[name] = tally.counts.get(name, 0) + 1
            tally.half += fault.startswith(HALF)
            if fault:
                tally.faults.append(f"{name}: {fault}")
            shutil.rmtree(here)
    return asdict(tally)


def _undisturbed(job: Job, folder: Path) -> Scene:
    """The whole results: the same from a command line and from a child as will be killed.

    Raises:
        RuntimeError: the job cannot be done, is not the same each time, or leaves threads, which a fork would lose.
    """
    first, again = folder / f"first_{job.runner}", folder / f"again_{job.runner}"
    first.mkdir()
    again.mkdir()
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})  # libraries that start a thread a core start none
    call, code = first_run(job, first)
    os.sched_setaffinity(0, cores)
    if code not in job.codes:
        raise RuntimeError(f"{job.runner} cannot even be done undisturbed: {said(os.getpid(), first)}")
    scene = Scene(job, call, results(job, first))
    if (threads := len(os.listdir("/proc/self/task"))) > 1:
        raise RuntimeError(f"{job.runner} leaves {threads - 1} threads; a child of this process would lack them.")
    begin = time.monotonic()
    child = start(call, again)
    if wait(child) not in job.codes or results(job, again) != scene.whole:
        raise RuntimeError(f"{job.runner} does not give the same twice: {_fault(scene, again, said(child, again))}")
    scene.took_s = time.monotonic() - begin
    return scene


def _tell(tally: Tally) -> None:
    counts = ", ".join(f"{count} {name}" for name, count in tally.counts.items())
    print(f"{tally.runner:14} {tally.took_s:5.2f} s undisturbed; {counts}; {len(tally.faults)} faults", flush=True)
    for fault in tally.faults[:10]:
        print(f"    {fault}", flush=True)


def _report(settings: dict[str, Any], tallies: list[Tally]) -> Report:
    """The figures as every suite keeps them."""
    report = Report("chaos", settings)
    for tally in tallies:
        for name, count in tally.counts.items():
            wrong = sum(fault.startswith(f"{name}:") for fault in tally.faults)
            report.add(tally.runner, f"{name}, and ended by the same call with the same bytes", "%",
                       [100.0 * (1 - wrong / count)], n=count)  # fmt: skip
        report.add(tally.runner, "half results readable as whole", "results", [float(tally.half)],
                   n=max(sum(tally.counts.values()), 1))  # fmt: skip
        report.add(tally.runner, "undisturbed, what only computes remembered", "s", [tally.took_s])
    return report


def _fault(scene: Scene, here: Path, what: str) -> str:
    """How the results that stand differ from the whole ones; blank where they do not, or none stands."""
    found = results(scene.job, here)
    wrong = sorted(name for name in found if found[name] != scene.whole.get(name))
    if wrong:
        return f"{HALF} {what}: {', '.join(wrong[:3])} is not what it should be"
    first = [name for name in scene.whole if name == scene.job.out or name.startswith(scene.job.out + "/")]
    if any(name in found for name in first) and found.keys() != scene.whole.keys():
        missing = ", ".join(sorted(scene.whole.keys() - found.keys())[:3])
        return f"{HALF} {what}: {scene.job.out} stands, but {missing} is missing"
    return ""


def _ended(scene: Scene, here: Path, what: str) -> str:
    """The same call once more: it ends it, or says that the result stands."""
    stood = results(scene.job, here).keys() == scene.whole.keys()
    child = start(scene.call, here)
    code, text = wait(child), said(child, here)
    if code not in scene.job.codes and not (stood and "exists already" in text):
        return f"{what}, the same call ends with {code}: {text[-300:]}"
    if results(scene.job, here) != scene.whole:
        return f"{what}, the same call ends in other bytes. " + _fault(scene, here, what)
    left = [p.name for p in here.iterdir() if p.suffix != ".log" and p.name not in (scene.job.out, *scene.job.besides)]
    return f"{what}: {left} is left behind" if [n for n in left if not n.endswith((".lock", ".partial"))] else ""


def _killed(scene: Scene, here: Path, rng: random.Random) -> str:
    child, after = start(scene.call, here), rng.uniform(0, 1.1 * scene.took_s)
    time.sleep(after)
    kill(child)
    wait(child)
    what = f"killed after {after:.2f} s"
    return _fault(scene, here, what) or _ended(scene, here, what)


def _stopped(scene: Scene, here: Path, rng: random.Random) -> str:
    """Stopped, the same call beside it, and going on."""
    first, after = start(scene.call, here), rng.uniform(0, scene.took_s)
    time.sleep(after)
    kill(first, signal.SIGSTOP)
    second = start(scene.call, here)
    code = wait(second)
    kill(first, signal.SIGCONT)
    return _both(scene, here, {first: wait(first), second: code}, f"stopped after {after:.2f} s")


def _doubled(scene: Scene, here: Path, rng: random.Random) -> str:
    """Two at once."""
    children = [start(scene.call, here), start(scene.call, here)]
    return _both(scene, here, {child: wait(child) for child in children}, "two at once")


def _both(scene: Scene, here: Path, codes: dict[int, int], what: str) -> str:
    if not any(code in scene.job.codes for code in codes.values()):
        return f"{what}: none came to its end: " + "; ".join(said(child, here)[-200:] for child in codes)
    for child, code in codes.items():
        if code not in scene.job.codes and not any(text in said(child, here) for text in _REFUSALS):
            return f"{what}: one ended with {code}: {said(child, here)[-300:]}"
    if sum(code in scene.job.codes for code in codes.values()) > 1:
        return f"{what}: both say that they made it"
    return (
        "" if results(scene.job, here) == scene.whole else _fault(scene, here, what) or f"{what}: results are missing"
    )


def _full(scene: Scene, here: Path, rng: random.Random) -> str:
    """A disk with room for files of some size only."""
    room = int(rng.choice((0, 1, 100, 1000, 10_000)) * rng.uniform(1, 10))
    child = start(scene.call, here, room=room)
    code, text = wait(child), said(child, here)
    what = f"files of {room} bytes at most"
    if code not in scene.job.codes and "Traceback" in text:
        return f"{what}: no sentence: {text[-300:]}"
    return _fault(scene, here, what) or _ended(scene, here, what)


def _clock(scene: Scene, here: Path, rng: random.Random) -> str:
    """Killed under one clock, ended under another."""
    child = start(scene.call, here, clock_s=rng.uniform(-1e8, 1e8))
    time.sleep(rng.uniform(0, scene.took_s))
    kill(child)
    wait(child)
    return _ended(scene, here, "the clock jumped")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
