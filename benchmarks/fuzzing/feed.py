"""The process that feeds readers: every input is made from its number, so that the one that kills it is known."""

import contextlib
import faulthandler
import os
import random
import re
import shutil
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.fuzzing.discover import Reader
from benchmarks.fuzzing.mutate import mutate
from ursnav_torch.errors import UrsnavError
from ursnav_torch.vid.store import write_description

#: An input that takes so long hangs, in seconds of this process's own time, which a busy machine does not stretch; and
#: in seconds on the wall, for those that wait.
HANG_S, WAIT_S = 5.0, 60.0


class HangError(BaseException):
    """An input took longer than is allowed."""


@dataclass(slots=True)
class Tally:
    """What came of one reader's inputs; ``findings`` are texts by what tells them apart, with the input's number."""

    inputs: int = 0
    refused: int = 0
    findings: dict[str, tuple[int, str]] = field(default_factory=dict)
    slowest_s: float = 0.0


class Feeder:
    """Makes inputs for one reader and gives them to it.

    Args:
        reader: to be fed.
        seeds: good files and folders.
        work: folder to write inputs to.
        seed: of all randomness.
    """

    def __init__(self, reader: Reader, seeds: Path, work: Path, seed: int) -> None:
        self.reader, self.seed, self.tally = reader, seed, Tally()
        self._work = work / reader.name
        self._work.mkdir(parents=True, exist_ok=True)
        self._places = self._fitting([*sorted(seeds.iterdir()), *sorted(p for p in seeds.glob("*/*") if p.is_dir())])

    def _fitting(self, places: list[Path]) -> list[Path]:
        """The seeds that the reader takes as they are, and those of the same endings; all where it takes none."""
        if self.reader.takes == "bytes":
            small = [path for path in places if path.is_file() and path.stat().st_size < 1 << 16]
            good = [path for path in small if self._takes(path)]
            return good + [path for path in small if path.suffix == ".wire" and path not in good]
        good = [path for path in places if not path.name.startswith("known_") and self._takes(path)]
        endings = {path.suffix for path in good if path.is_file()}
        fitting = good + [p for p in places if p not in good and p.is_file() and p.suffix in endings]
        return fitting or places

    def _takes(self, path: Path) -> bool:
        try:
            with _alarm():
                self.reader.call(path if self.reader.takes == "path" else path.read_bytes())
        except (Exception, HangError):
            return False
        return True

    def input(self, number: int) -> tuple[Path, Path, bytes, bool]:
        """Input ``number``: its seed, the file in it to be changed, the bytes, and whether checksums are made anew."""
        rng = random.Random(f"{self.seed}/{self.reader.name}/{number}")
        place = rng.choice(self._places)
        file = place if place.is_file() else rng.choice(sorted(p for p in place.rglob("*") if p.is_file()))
        others = [p.read_bytes() for p in rng.sample(self._places, min(2, len(self._places))) if p.is_file()]
        return place, file, mutate(file.read_bytes(), others, rng), rng.random() < 0.5

    def feed(self, number: int) -> None:
        """Give one input to the reader and note what came of it."""
        place, file, data, seal = self.input(number)
        start = time.process_time()
        altered = data != file.read_bytes()
        try:
            with self._laid_out(place, file, data, seal) as (target, sealed), _alarm():
                self.reader.call(target)
            if place.is_dir() and self.reader.name.endswith("load_vid") and altered and not sealed:
                if "images" not in file.parts:
                    self._found(number, "altered and accepted", f"{file.name} was altered, and the VID was loaded")
        except UrsnavError:
            self.tally.refused += 1
        except (Exception, HangError) as error:
            at = traceback.extract_tb(error.__traceback__)
            own = [f for f in at if "ursnav_torch" in f.filename] or at
            where = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
            self._found(
                number, f"{type(error).__name__} {where}", f"{type(error).__name__}: {error}"[:200] + f" ({where})"
            )
        self.tally.inputs += 1
        self.tally.slowest_s = max(self.tally.slowest_s, time.process_time() - start)

    def _found(self, number: int, kind: str, text: str) -> None:
        self.tally.findings.setdefault(kind, (number, text))

    @contextlib.contextmanager
    def _laid_out(self, place: Path, file: Path, data: bytes, seal: bool) -> Iterator[tuple[Any, bool]]:
        """What the reader is given, and whether its checksums were made anew."""
        if self.reader.takes == "bytes":
            yield data, False
        elif place.is_file():
            target = self._work / f"input{''.join(place.suffixes)}"
            target.write_bytes(data)
            yield target, False
        else:
            target = self._work / place.name
            if not target.exists():
                shutil.copytree(place, target)
            inside = target / file.relative_to(place)
            inside.write_bytes(data)
            sealed = seal and _seal(target)
            try:
                yield target, sealed
            finally:
                inside.write_bytes(file.read_bytes())
                if sealed:
                    shutil.copy(place / "vid.json", target / "vid.json")


def _seal(vid: Path) -> bool:
    """Make a VID's checksums anew, as somebody would who wants to be believed."""
    import json

    try:
        about = json.loads((vid / "vid.json").read_bytes())
        write_description(vid, {k: v for k, v in about.items() if k not in ("sha256", "checksum")})
    except (OSError, ValueError, AttributeError, RecursionError):
        return False
    return True


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Raise `HangError` after `HANG_S` of work or `WAIT_S` of waiting; end the process where even that is held up."""

    def ring(signum: int, frame: FrameType | None) -> None:
        raise HangError("longer than is allowed")

    signal.signal(signal.SIGPROF, ring)
    signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    signal.setitimer(signal.ITIMER_REAL, WAIT_S)
    faulthandler.dump_traceback_later(2 * WAIT_S, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)


def peak_mb() -> float:
    """Most memory in MiB that this process ever held, from the kernel's high-water mark of its own image.

    ``ru_maxrss`` would not do: a program inherits it from whoever started it, so a large parent is counted as well.
    """
    mark = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(encoding="utf-8"))
    if mark is None:
        raise OSError("/proc/self/status has no VmHWM: memory cannot be told here; fuzz on Linux")
    return int(mark[1]) / 1024


def quiet() -> None:
    """No warnings, no numpy complaints, no decoders' talk: only exceptions count."""
    import numpy as np

    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
