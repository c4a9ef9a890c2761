"""Runners in children of this process, which has everything imported: seconds are spent on work, and death is real."""

import os
import re
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig

from benchmarks.disturbing.jobs import Job
from ursnav_torch import _runner

#: CSV columns that tell how long something took, and what no two runs have in common in other files.
_TIMES = ("seconds",)


@dataclass(frozen=True, slots=True)
class Call:
    """A runner's task and its composed configuration: what its command line comes to, before anything is done."""

    task: Callable[[Any], int | None]
    config: Any
    hydra: Any

    def __call__(self) -> None:
        """Run it; ends with `SystemExit`, as its process would."""
        HydraConfig.instance().cfg = self.hydra
        _runner._run(self.task, self.config)


def first_run(job: Job, folder: Path) -> tuple[Call, int]:
    """Run a job in this process, by its command line; what to call from then on, and its exit code."""
    calls: list[Call] = []
    run = _runner._run

    def caught(task: Callable[[Any], int | None], config: Any) -> None:
        calls.append(Call(task, config, HydraConfig.instance().cfg))
        run(task, config)

    _runner._run = caught  # type: ignore[assignment]
    sys.argv = [f"{job.runner}.py", *job.overrides, f"out={job.out}"]
    kept = [os.dup(1), os.dup(2)]
    try:
        code = _in_folder(folder, import_module(f"ursnav_torch.{job.runner}").main)
    finally:
        _runner._run = run
        for number, descriptor in enumerate(kept, 1):
            os.dup2(descriptor, number)
            os.close(descriptor)
    return calls[0], code


def start(call: Callable[[], None], folder: Path, *, room: int | None = None, clock_s: float = 0.0) -> int:
    """Start a call in a folder, in a child of this process; the child's number.

    Args:
        call: what to run.
        folder: where its results go.
        room: bytes that a file may have at most: a full disk.
        clock_s: how far the child's clock is off.
    """
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        if room is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        if clock_s:
            real = time.time
            time.time = lambda: real() + clock_s
        code = _in_folder(folder, call)
    except BaseException as error:
        os.write(2, f"{type(error).__name__}: {error}\n".encode())
    finally:
        os._exit(code)


def _in_folder(folder: Path, call: Callable[[], None]) -> int:
    """Call in a folder, with what is printed in a log there; the exit code."""
    os.chdir(folder)
    log = os.open(folder / f"{os.getpid()}.log", os.O_WRONLY | os.O_CREAT)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    try:
        call()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    finally:
        sys.stdout.flush()
    return 0


def wait(child: int) -> int:
    """The exit code of a child; negative the signal that ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def said(child: int, folder: Path) -> str:
    """What a child printed."""
    path = folder / f"{child}.log"
    return path.read_text(errors="replace").strip() if path.exists() else ""


def kill(child: int, number: int = signal.SIGKILL) -> None:
    """Send a signal to a child."""
    os.kill(child, number)


def results(job: Job, folder: Path) -> dict[str, Any]:
    """The bytes of all results that stand, by name, without what tells how long something took."""
    found: dict[str, Any] = {}
    for name in (job.out, *job.besides):
        path = folder / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []:
            if file.is_file():
                found[file.relative_to(folder).as_posix()] = _plain(file, folder)
    return found


def _plain(file: Path, folder: Path) -> bytes:
    data = file.read_bytes().replace(str(folder).encode(), b"FOLDER")
    if file.suffix == ".csv":
        lines = [line.split(b",") for line in data.split(b"\n")]
        drop = {i for i, name in enumerate(lines[0]) if name.decode() in _TIMES}
        return b"\n".join(b",".join(c for i, c in enumerate(line) if i not in drop) for line in lines)
    return re.sub(rb"\d+(\.\d+)? (s|ms|seconds)\b", b"TIME", data) if file.suffix in (".html", ".json") else data
