"""Every reader and wire parser of the package, fed with inputs that are almost right.

    python -m benchmarks.fuzz inputs=1000000 least=1000 seconds=7200   # the bar; ends when both counts are reached
    python -m benchmarks.fuzz seconds=60 seed=7 only=kidney.tables
    python -m benchmarks.fuzz only=kidney.mesh.read_mesh number=1234 keep=found   # write that input to a folder

Readers are found by their signatures (see ``benchmarks.fuzzing.discover``); good files are made from the phantom,
bad ones that were found before come from ``URSNAV_CASES``. The bar: no exception but the package's own, no hang, no
death of the process, at most 1.5 GiB, and no altered VID accepted. Exit code 1 where it does not hold; with ``out=``
the figures are kept.
"""

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.fuzzing.discover import Reader, find_readers
from benchmarks.fuzzing.feed import HANG_S, Feeder, Tally, peak_mb, quiet, watch, watch_turn
from benchmarks.fuzzing.seeds import make_seeds
from benchmarks.shared.results import Report, overrides

SETTINGS = {
    "seconds": 60.0, "inputs": 0, "least": 0, "seed": 0, "only": "", "number": -1, "keep": "", "most_mb": 1536.0,
    "out": "-",
}  # fmt: skip
#: Seconds of work for which one reader is fed before the next one's turn; those that are behind ``least`` get more.
TURN_S, MORE_S = 0.3, 1.5


def main(arguments: list[str]) -> int:
    """Feed all readers for some time, print what was found."""
    settings = overrides(SETTINGS, arguments)
    readers = [r for r in find_readers() if str(settings["only"]) in r.name]
    with tempfile.TemporaryDirectory() as scratch:
        make_seeds(Path(scratch) / "seeds")
        if int(settings["number"]) >= 0:
            return _keep(readers[0], Path(scratch), settings)
        tallies, peak, deaths = _fed([r.name for r in readers], Path(scratch), settings)
    _told(tallies, peak, deaths)
    if settings["out"] != "-":
        _report(settings, tallies, peak, deaths).finish(str(settings["out"]))
    return int(bool(any(t.findings for t in tallies.values()) or deaths or peak > float(settings["most_mb"])))


def _fed(names: list[str], scratch: Path, settings: dict[str, Any]) -> tuple[dict[str, Tally], float, list[str]]:
    """Feed in another process, and in a new one after each death; tallies, peak memory in MiB, and the deaths."""
    context = multiprocessing.get_context("spawn")
    until = time.monotonic() + float(settings["seconds"])
    tallies, peak, deaths = {name: Tally() for name in names}, 0.0, list[str]()
    told_s = time.monotonic()
    while time.monotonic() < until and len(deaths) < 100 and not _enough(tallies, settings):
        ours, theirs = context.Pipe()
        now = context.Array("q", [0, 0])
        left = until - time.monotonic()
        work = (names, tallies, scratch, settings | {"seconds": left}, theirs, now)
        process = context.Process(target=_work, args=work)
        process.start()
        theirs.close()
        while True:
            try:
                tallies, peak_now = ours.recv()
                peak, told_s = max(peak, peak_now, *(t.peak_mb for t in tallies.values())), _tell(tallies, told_s)
            except EOFError:
                break
        process.join()
        if process.exitcode:
            name, number = names[now[0]], now[1]
            deaths.append(f"{name} number={number}: the process ended with {process.exitcode}")
            tallies[name].inputs = number + 1
    return tallies, peak, deaths


def _enough(tallies: dict[str, Tally], settings: dict[str, Any]) -> bool:
    """Whether all readers together, and each of them, were given what ``inputs`` and ``least`` ask for."""
    counts = [tally.inputs for tally in tallies.values()]
    return settings["inputs"] > 0 and sum(counts) >= settings["inputs"] and min(counts) >= settings["least"]


def _tell(tallies: dict[str, Tally], told_s: float) -> float:
    """Say on standard error, once a minute, how far it is; when that was last done."""
    if time.monotonic() - told_s < 60:
        return told_s
    counts, found = [t.inputs for t in tallies.values()], list(_findings(tallies))
    print(f"{sum(counts)} inputs, {min(counts)} at least a reader, {len(found)} findings", file=sys.stderr)
    print("".join(f"  {text}\n" for text in found), end="", file=sys.stderr, flush=True)
    return time.monotonic()


def _findings(tallies: dict[str, Tally]) -> Iterator[str]:
    """Every finding, with what makes its input anew."""
    for name, tally in tallies.items():
        for number, text in tally.findings.values():
            yield f"{name} number={number}: {text}"


def _work(
    names: list[str], tallies: dict[str, Tally], scratch: Path, settings: dict[str, Any], pipe: Any, now: Any
) -> None:
    """Feed the readers in turns; tells tallies after each round, and in ``now`` which input is being read."""
    quiet()
    watch()
    until = time.monotonic() + float(settings["seconds"])
    readers = {reader.name: reader for reader in find_readers()}
    feeders = []
    for place, name in enumerate(names):
        now[0], now[1] = place, -1
        watch_turn()
        feeder = Feeder(readers[name], scratch / "seeds", scratch / "work", int(settings["seed"]))
        feeder.tally = tallies[name]
        feeders.append(feeder)
    while time.monotonic() < until and not _enough(tallies, settings):
        total = sum(tally.inputs for tally in tallies.values())
        for place, feeder in enumerate(feeders):
            behind = feeder.tally.inputs < settings["least"]
            if behind or not settings["inputs"] or total < settings["inputs"]:
                _turn(feeder, place, MORE_S if behind else TURN_S, now, float(settings["most_mb"]))
        pipe.send(({f.reader.name: f.tally for f in feeders}, peak_mb()))
    pipe.close()


def _turn(feeder: Feeder, place: int, seconds: float, now: Any, most_mb: float) -> None:
    """Feed one reader for some seconds of this process's own time, or three times as many on the wall."""
    watch_turn()
    worked, waited = time.process_time() + seconds, time.monotonic() + 3 * seconds
    while time.process_time() < worked and time.monotonic() < waited:
        now[0], now[1] = place, feeder.tally.inputs
        feeder.feed(feeder.tally.inputs)
        feeder.heed_memory(most_mb)


def _keep(reader: Reader, scratch: Path, settings: dict[str, Any]) -> int:
    """Write one input to a folder, for a test."""
    feeder = Feeder(reader, scratch / "seeds", scratch / "work", int(settings["seed"]))
    place, file, data, sealed = feeder.input(int(settings["number"]))
    folder = Path(str(settings["keep"]) or ".")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{settings['number']}_{file.name}").write_bytes(data)
    print(f"{reader.name}: {place.name}, {file.name}, {len(data)} bytes, checksums made anew: {sealed}")
    return 0


def _told(tallies: dict[str, Tally], peak: float, deaths: list[str]) -> None:
    """Print a table and the findings."""
    print(f"{'reader':48} {'inputs':>9} {'refused':>9} {'slowest s':>9}  findings")
    for name, tally in tallies.items():
        print(f"{name:48} {tally.inputs:9} {tally.refused:9} {tally.slowest_s:9.2f}  {len(tally.findings)}")
    total, found = sum(t.inputs for t in tallies.values()), sum(len(t.findings) for t in tallies.values())
    print(f"{len(tallies)} readers, {total} inputs, {found} findings, {len(deaths)} deaths, peak {peak:.0f} MiB")
    for text in (*_findings(tallies), *deaths):
        print(f"  {text}")


def _report(settings: dict[str, Any], tallies: dict[str, Tally], peak: float, deaths: list[str]) -> Report:
    """The figures of a run as every suite keeps them."""
    report, total = Report("fuzz", settings), sum(t.inputs for t in tallies.values())
    found = [kind for tally in tallies.values() for kind in tally.findings]
    hangs = [kind for kind in found if kind.startswith("HangError")]
    vids = tallies.get("vid.store.load_vid", Tally())
    group = f"{len(tallies)} readers and parsers, {total} inputs"
    report.add(group, "exceptions that are not the package's own", "kinds", [float(len(found) - len(hangs))], n=total)
    report.add(group, f"inputs that took more than {HANG_S:g} s", "kinds", [float(len(hangs))], n=total)
    report.add(group, "deaths of the process", "deaths", [float(len(deaths))], n=total)
    report.add(group, "memory at most", "MiB", [peak])
    report.add(group, "VIDs altered and not sealed anew, refused", "%",
               [100.0 * (1 - vids.accepted_altered / max(vids.altered, 1))], n=max(vids.altered, 1))  # fmt: skip
    for name, tally in tallies.items():
        report.add("inputs of each", name, "inputs", [float(tally.inputs)], f"{tally.refused} refused, "
                   f"slowest {tally.slowest_s:.2f} s", n=max(tally.inputs, 1))  # fmt: skip
    return report


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
