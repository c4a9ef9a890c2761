"""Screening of large view databases: ``python -m benchmarks.screening views=100000 queries=200 threads=2``.

Distinct drawn edge maps of 100 points, their screen built into a temporary file and opened from there. A query is
one of them seen again (turned, scaled, noisy), in part, with clutter; a hit is the same shape. Reported are recall,
milliseconds a query from points to shortlist and to full costs of the shortlist, opening time and memory.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.shared import shapes as drawn_shapes
from benchmarks.shared.results import Report, overrides
from ursnav_torch.matching import Matching, Nearest, Occupancy, PairCost, Screen, ShapeContext, build_screen

Floats = NDArray[np.float64]
DEFAULTS = {"views": 100_000, "queries": 200, "threads": 2, "seed": 11, "out": ""}
#: Share of the edge kept, clutter points, and how far the query is shifted at most, px.
CASES = ((1.0, 0, 0.0), (0.7, 0, 0.0), (0.7, 30, 0.0), (0.7, 30, 15.0), (0.5, 30, 0.0))
#: The second look: shape, place and direction of the best 70 % of the query's points.
SECOND = Matching(
    ShapeContext(scale=60.0),
    PairCost(position_weight=1.0, direction_weight=0.5),
    Nearest(),
)
_SIDE = 250.0


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(settings["threads"])
    report = Report("screening", {k: v for k, v in settings.items() if k != "out"})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "screen.safetensors"
        views = drawn_shapes.edge_views(settings["views"], 100, settings["seed"])
        start = time.perf_counter()
        points = torch.from_numpy(views).float()
        mask = torch.ones(points.shape[:2], dtype=torch.bool)
        build_screen(path, points, mask, settings=Occupancy((0, 0), (_SIDE, _SIDE)))
        group = f"Screen of {settings['views']:,} distinct views of 100 points"
        report.add(group, "building, once", "s", [time.perf_counter() - start])
        report.add(group, "size of the file", "MiB", [path.stat().st_size / 2**20])
        numbers = np.random.default_rng(settings["seed"]).integers(0, len(views), settings["queries"])
        asked = views[numbers]
        del views, points, mask
        _measure_memory(report, group, path, asked, settings["threads"])
        screen = Screen(path)
        for keep, clutter, shift in CASES:
            recall(report, screen, asked, numbers, keep, clutter, shift)
    report.finish(settings["out"])
    return 0


def recall(
    report: Report, screen: Screen, asked: Floats, numbers: NDArray[np.int64], keep: float, clutter: int, shift: float
) -> None:
    """Recall and time of one kind of query."""
    rng = np.random.default_rng(5)
    ranks, finals, first, both = [], [], [], []
    for view, number in zip(asked, numbers, strict=True):
        seen = drawn_shapes.observe(view, rng, keep, clutter) + rng.uniform(-shift, shift, 2)
        query = torch.from_numpy(seen).float()
        start = time.perf_counter()
        short = screen.shortlist(query, count=100)
        first.append((time.perf_counter() - start) * 1e3)
        start = time.perf_counter()
        final, _ = screen.nearest(query, settings=SECOND, count=100)
        both.append((time.perf_counter() - start) * 1e3)
        ranks.append(bool((short == number).any()))
        finals.append(int(final[0]) == number)
    group = f"{keep:.0%} of the edge, {clutter} clutter points, shifted up to {shift:.0f} px"
    report.add(group, "recall@100 of the shortlist", "%", [100 * float(np.mean(ranks))], n=len(asked))
    report.add(group, "first after full costs of the 100", "%", [100 * float(np.mean(finals))], n=len(asked))
    report.add(group, "query to shortlist", "ms", first)
    report.add(group, "query to full costs of the 100", "ms", both)


_PROBE = """
import sys, time, numpy, torch
from pathlib import Path
from benchmarks.screening import SECOND, resident
from ursnav_torch.matching import Screen
torch.set_num_threads(int(sys.argv[3]))
start = time.perf_counter()
screen = Screen(Path(sys.argv[1]))
opened = time.perf_counter() - start
for query in numpy.load(sys.argv[2])[:20]:
    screen.nearest(torch.from_numpy(query).float(), settings=SECOND, count=100)
print(opened, resident())
"""


def _measure_memory(report: Report, group: str, path: Path, asked: Floats, threads: int) -> None:
    """Opening time, and resident memory after 20 queries, in a process of its own."""
    queries = path.with_name("queries.npy")
    np.save(queries, asked)
    command = [sys.executable, "-c", _PROBE, str(path), str(queries), str(threads)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=Path(__file__).parents[1])
    opened, memory = map(float, done.stdout.split())
    report.add(group, "opening", "s", [opened])
    report.add(group, "greatest resident memory, 20 queries", "MiB", [memory])


def resident() -> float:
    """Greatest resident memory of this process so far in MiB."""
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
