"""Mutation testing: faults of one line are planted in lines that decide, and the nearest tests have to notice.

    python -m benchmarks.mutants                           # all rooms; a quarter of an hour on one core
    python -m benchmarks.mutants workers=2                 # so many faults at a time; 0 for as many as there are cores
    python -m benchmarks.mutants rooms=search,tracking
    python -m benchmarks.mutants only=tukey keep=true      # one by its name; what its tests said is shown

The faults stand in ``mutants.toml``. Each is planted in a copy of the checkout, never in the checkout itself; the
tests named beside it run there until the first one fails. A fault whose old line is gone, or stands more than once,
is an error that names it: a plan that no longer meets the code proves nothing. The same tests must pass without any.

The packages that the tests need are imported once, and every run is a fork of that process; each worker has a copy of
its own, and builds the small VID of the tests once for all rooms above `vid`.
"""

import importlib
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.shared.results import Report, overrides
from ursnav_torch.errors import InputError

SETTINGS = {"rooms": "", "only": "", "keep": False, "workers": 0, "out": ""}
ROOT = Path(__file__).parents[1]
PLAN = Path(__file__).with_suffix(".toml")
#: Share of the faults that must be noticed.
NEEDED = 0.95
#: Tests that compute or wait longer than this with a fault planted have noticed it: it made a loop that does not end.
#: Computing is counted by the processor's time, so that a busy machine makes no difference.
LONGEST_COMPUTING_S, LONGEST_S = 180, 1800.0
_COPIED = ("ursnav_torch", "configs", "tests", "benchmarks", "docs", "README.md", "CONTRIBUTING.md", "pyproject.toml")
_PRELOADED = ("torch", "kornia", "cv2", "scipy.spatial.transform", "scipy.optimize", "scipy.ndimage", "trimesh",
              "networkx", "embreex", "skimage.measure", "hydra", "hypothesis", "pytest", "safetensors", "rich",
              "matplotlib.figure", "SimpleITK", "serial")  # fmt: skip
#: Rooms whose faults change what the small VID of the tests holds, so that it has to be built anew.
_BUILD_ANEW = ("camera", "features", "files", "geometry", "kidney", "rendering", "vid")
_PRELOADED_ANYWAY = "ignore::pytest.PytestAssertRewriteWarning"
_PASSED, _FAILED, _BROKEN = 0, 1, 99


@dataclass(frozen=True, slots=True)
class Mutant:
    """A fault of one line.

    Attributes:
        name: what goes wrong, in a few words.
        file: below ``ursnav_torch/``.
        old, new: a piece of text that stands there once, and what takes its place.
        tests: what pytest is given; files, or files with the name of a test.
        why: for a fault that may survive: what else holds, or why no test can tell; blank for one that must not.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    why: str = ""

    @property
    def room(self) -> str:
        """The folder, or the module, of the package that the file stands in."""
        return Path(self.file).parts[0].removesuffix(".py")


def read_plan(path: Path, root: Path) -> list[Mutant]:
    """The faults of a plan, each checked against the code.

    Args:
        path: TOML with one ``[[mutant]]`` a fault.
        root: the checkout.

    Raises:
        InputError: a fault cannot be planted as it stands, or its tests do not exist; the message names all such.
    """
    mutants = [
        Mutant(**row | {"tests": tuple(row["tests"])})
        for row in tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
    ]
    wrong = []
    for m in mutants:
        file = root / "ursnav_torch" / m.file
        times = file.read_text(encoding="utf-8").count(m.old) if file.is_file() else 0
        if times != 1:
            where = f"stands {times} times in" if file.is_file() else "belongs to the missing file"
            wrong.append(f"{m.name}: {m.old!r} {where} {m.file}")
        wrong += [f"{m.name}: there is no {test}" for test in m.tests if not (root / test.split("::")[0]).is_file()]
    names = [m.name for m in mutants]
    wrong += [f"{name}: named twice" for name in sorted({name for name in names if names.count(name) > 1})]
    if wrong:
        raise InputError(f"{path.name} no longer meets the code; mend these entries:\n  " + "\n  ".join(wrong))
    return mutants


def plant(mutant: Mutant, root: Path) -> None:
    """Write a fault into a copy of the checkout; its time tells Python not to trust what it had compiled before."""
    file = root / "ursnav_torch" / mutant.file
    file.write_text(file.read_text(encoding="utf-8").replace(mutant.old, mutant.new))
    os.utime(file, (time.time() + 1e6,) * 2)


def run_tests(root: Path, tests: Sequence[str], log: Path, vid: str = "", limited: bool = True) -> int:
    """Run tests in a fork of this process against a copy of the checkout, until the first fails.

    Args:
        root: the copy; it is the working folder, and its package is the one imported.
        tests: what pytest is given.
        log: takes what pytest says.
        vid: folder in which the small VID of the tests is kept from run to run; blank to build it anew.
        limited: whether to end them after `LONGEST_COMPUTING_S` or `LONGEST_S`.

    Returns:
        Pytest's exit code, or that of the signal that ended it, which is below 0.
    """
    child = os.fork()
    if child == 0:
        os.setsid()
        if limited:
            resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_COMPUTING_S, LONGEST_COMPUTING_S + 5))
        code = _BROKEN
        try:  # whatever happens, the fork must not go on with its parent's work
            code = _pytest(root, tests, log, vid)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    end = time.monotonic() + LONGEST_S
    while not limited or time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _pytest(root: Path, tests: Sequence[str], log: Path, vid: str) -> int:
    """In the fork: pytest's exit code."""
    with log.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(root)
    os.environ |= {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    os.environ.pop("URSNAV_TEST_VID", None)
    if vid:
        os.environ["URSNAV_TEST_VID"] = vid
    sys.dont_write_bytecode = True
    sys.path[:] = [str(root), *(p for p in sys.path if p not in ("", str(ROOT)))]
    for name in [n for n in sys.modules if n.split(".")[0] in ("ursnav_torch", "benchmarks")]:
        del sys.modules[name]
    import pytest

    code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-W", _PRELOADED_ANYWAY, *tests]))
    sys.stdout.flush()
    return code


def main(arguments: list[str]) -> None:
    """Plant, run, print; ends with 1 where fewer than `NEEDED` of the faults are noticed."""
    settings: dict[str, Any] = overrides(SETTINGS, arguments)
    plan = read_plan(PLAN, ROOT)
    rooms = set(filter(None, settings["rooms"].split(",")))
    if unknown := rooms - {m.room for m in plan}:
        raise InputError(f"No fault is planned in {sorted(unknown)}; rooms are {sorted({m.room for m in plan})}.")
    chosen = [m for m in plan if (not rooms or m.room in rooms) and settings["only"] in m.name]
    if not chosen:
        raise InputError(f"No fault's name holds only={settings['only']!r}.")
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for name in _PRELOADED:
        importlib.import_module(name)
    report = Report("mutants", {"rooms": settings["rooms"], "only": settings["only"]})
    with tempfile.TemporaryDirectory() as scratch:
        share = _try_all(chosen, Path(scratch), report, settings["workers"] or os.cpu_count() or 1, settings["keep"])
    print(report.table())
    whole = not rooms and not settings["only"]
    if settings["out"] or whole:
        print(f"\nwritten to {report.write(Path(settings['out']) if settings['out'] else None)}")
    sys.exit(0 if share >= NEEDED else 1)


@dataclass(frozen=True, slots=True)
class _Tried:
    """What tests said: pytest's exit code, after how many seconds, and the end of its words."""

    code: int
    seconds: float
    said: str


@dataclass(frozen=True, slots=True)
class _Bench:
    """A worker's own copy of the checkout, with what its tests say and the small VID that they share."""

    folder: Path

    @classmethod
    def set_up(cls, scratch: Path) -> "_Bench":
        """A new copy."""
        bench = cls(scratch / str(os.getpid()))
        bench.root.mkdir(parents=True)
        for name in _COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, bench.root / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(ROOT / name, bench.root / name)
        return bench

    @property
    def root(self) -> Path:
        """The copy."""
        return self.folder / "copy"

    def run(self, tests: Sequence[str], room: str = "", limited: bool = True) -> _Tried:
        """Run tests there; the VID is built anew where a fault in the room changes what it holds."""
        begun, log = time.monotonic(), self.folder / "log.txt"
        vid = "" if room in _BUILD_ANEW else str(self.folder / "vid")
        code = run_tests(self.root, tests, log, vid, limited)
        return _Tried(code, time.monotonic() - begun, log.read_text(encoding="utf-8")[-4000:])


_bench: _Bench


def _start_worker(scratch: Path) -> None:
    global _bench
    _bench = _Bench.set_up(scratch)


def _try_without(test: str) -> _Tried:
    """A test in the code as it is."""
    return _bench.run([test], limited=False)


def _try_with(mutant: Mutant) -> _Tried:
    """A fault's tests, with the fault."""
    original = _bench.root / "ursnav_torch" / mutant.file
    shutil.copy2(original, _bench.folder / "original")
    plant(mutant, _bench.root)
    try:
        return _bench.run(mutant.tests, mutant.room)
    finally:
        shutil.copy2(_bench.folder / "original", original)


def _try_all(mutants: Sequence[Mutant], scratch: Path, report: Report, workers: int, keep: bool) -> float:
    """Rows for the report, and the share of the faults that were noticed."""
    tests, begun = sorted({test for m in mutants for test in m.tests}), time.monotonic()
    with multiprocessing.get_context("fork").Pool(workers, _start_worker, (scratch,)) as pool:
        for test, tried in zip(tests, pool.imap(_try_without, tests), strict=True):
            if tried.code != _PASSED:
                raise InputError(f"{test} does not pass without any fault:\n{tried.said}")
        print(f"without any fault: passed in {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
        killed = []
        for m, tried in zip(mutants, pool.imap(_try_with, mutants), strict=True):
            if tried.code > _FAILED:
                raise InputError(f"{m.name}: the tests did not run (code {tried.code}):\n{tried.said}")
            killed.append(tried.code != _PASSED)
            word = "killed" if killed[-1] else f"SURVIVED {m.why}".strip()
            print(f"{m.room}: {m.name}: {word}, {tried.seconds:.0f} s", file=sys.stderr, flush=True)
            if keep:
                print(tried.said, file=sys.stderr)
            report.add(m.room, m.name, "killed", [float(killed[-1])], f"{m.file}; {word}")
    share = sum(killed) / len(killed)
    report.add("all rooms", "faults noticed", "%", [100 * share], f"at least {NEEDED:.0%} are needed", len(killed))
    return share


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(str(error))
