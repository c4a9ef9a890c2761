"""The process that feeds readers: every input is made from its number, so that the one that kills it is known."""

import contextlib
import faulthandler
import json
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
#: in seconds on the wall, for those that wait. A turn of many inputs that takes ``DEAD_S`` cannot even be interrupted.
HANG_S, WAIT_S, DEAD_S = 5.0, 120.0, 1200.0


#: How often a seed is taken that the reader accepts as it is: from the others most inputs get no farther than a header.
GOOD = 0.7


class HangError(BaseException):
    """An input took longer than is allowed."""


@dataclass(slots=True)
class Tally:
    """What came of one reader's inputs; ``findings`` are texts by what tells them apart, with the input's number.

    ``altered`` counts VIDs that were changed and not sealed anew, ``accepted_altered`` those of them that were read.
    """

    inputs: int = 0
    refused: int = 0
    altered: int = 0
    accepted_altered: int = 0
    findings: dict[str, tuple[int, str]] = field(default_factory=dict)
    slowest_s: float = 0.0
    peak_mb: float = 0.0


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
        self._files: dict[Path, list[Path]] = {}
        self._bytes: dict[Path, bytes] = {}
        places = [*sorted(seeds.iterdir()), *sorted(p for p in seeds.glob("*/*") if p.is_dir())]
        self._good, self._places = self._fitting(places)

    def _fitting(self, places: list[Path]) -> tuple[list[Path], list[Path]]:
        """Seeds that the reader takes as they are; and they with those of the same endings, all where it takes none."""
        if self.reader.takes == "bytes":
            small = [path for path in places if path.is_file() and path.stat().st_size < 1 << 16]
            good = [path for path in small if self._takes(path)]
            return good, good + [path for path in small if path.suffix == ".wire" and path not in good]
        good = [path for path in places if not path.name.startswith("known_") and self._takes(path)]
        endings = {path.suffix for path in good if path.is_file()}
        fitting = good + [p for p in places if p not in good and p.is_file() and p.suffix in endings]
        return good, fitting or places

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
        place = rng.choice(self._good if self._good and rng.random() < GOOD else self._places)
        if place not in self._files:
            self._files[place] = sorted(p for p in place.rglob("*") if p.is_file()) if place.is_dir() else [place]
        file = rng.choice(self._files[place])
        others = [self._data(p) for p in rng.sample(self._places, min(2, len(self._places))) if not p.is_dir()]
        return place, file, mutate(self._data(file), others, rng), rng.random() < 0.5

    def _data(self, path: Path) -> bytes:
        """The bytes of a seed, read once."""
        if path not in self._bytes:
            self._bytes[path] = path.read_bytes()
        return self._bytes[path]

    def feed(self, number: int) -> None:
        """Give one input to the reader and note what came of it."""
        place, file, data, seal = self.input(number)
        start, sealed = time.process_time(), False
        is_vid = place.name == "vid" and self.reader.name.endswith("load_vid")
        altered = not says_the_same(data, self._data(file))
        try:
            with self._laid_out(place, file, data, seal) as (target, sealed), _alarm():
                self.reader.call(target)
            if is_vid and altered and not sealed:
                self.tally.accepted_altered += 1
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
        self.tally.altered += is_vid and altered and not sealed
        self.tally.inputs += 1
        self.tally.slowest_s = max(self.tally.slowest_s, time.process_time() - start)

    def heed_memory(self, most_mb: float) -> None:
        """Note it where this process held more than ``most_mb`` since it was last asked: the last input took it."""
        if (peak := peak_mb()) > most_mb:
            self.tally.peak_mb = max(self.tally.peak_mb, peak)
            self._found(self.tally.inputs - 1, "memory", f"the process held {peak:.0f} MiB")
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the mark begins anew

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
                inside.write_bytes(self._data(file))
                if sealed:
                    (target / "vid.json").write_bytes(self._data(place / "vid.json"))


def says_the_same(data: bytes, original: bytes) -> bool:
    """Whether a file was not altered: equal bytes, or JSON of equal content, whatever its spaces and order."""
    if data == original:
        return True
    try:
        return bool(json.loads(data) == json.loads(original))
    except (ValueError, RecursionError):  # no JSON
        return False


def _seal(vid: Path) -> bool:
    """Make a VID's checksums anew, as somebody would who wants to be believed."""
    try:
        about = json.loads((vid / "vid.json").read_bytes())
        write_description(vid, {k: v for k, v in about.items() if k not in ("sha256", "checksum")})
    except (OSError, ValueError, AttributeError, RecursionError):
        return False
    return True


def watch() -> None:
    """Make timers of this process raise `HangError`; for the rest of its life."""

    def ring(signum: int, frame: FrameType | None) -> None:
        raise HangError("longer than is allowed")

    signal.signal(signal.SIGPROF, ring)
    signal.signal(signal.SIGALRM, ring)


def watch_turn() -> None:
    """End the process where not even `HangError` can be raised: call it every few seconds of feeding."""
    faulthandler.dump_traceback_later(DEAD_S, exit=True)


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Raise `HangError` after `HANG_S` of work or `WAIT_S` of waiting; `watch` must have been called."""
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    signal.setitimer(signal.ITIMER_REAL, WAIT_S)
    try:
        yield
    finally:
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
