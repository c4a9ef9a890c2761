"""This matcher and its rivals on the same points in one process: ``python -m benchmarks.matching``.

Arguments, each ``key=value``: ``views=40 rounds=7 threads=1 accuracy_views=100 accuracy_queries=40 growth=true
out=FILE.json``. OpenCV's extractors need opencv-contrib-python-headless; without it they are skipped.

A note on what lost: rings and sectors told by comparing squares and slopes in small whole numbers, in place of a
logarithm and an angle a pair. The histograms were the same and took as long (sets of 300 points, medians of 80 rounds
in turn: 1.28 ms and 1.27 ms; of 100 points, eight at a time: 1.03 ms and 1.05 ms).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.shared import rivals as rival_methods
from benchmarks.shared import shapes as drawn_shapes
from benchmarks.shared.outlines import outline
from benchmarks.shared.results import Report, overrides, time_interleaved
from ursnav_torch.features.sampling import METHODS, sample
from ursnav_torch.matching import (
    Hungarian,
    Matcher,
    Matching,
    Nearest,
    PairCost,
    ShapeContext,
    Sinkhorn,
    pack,
    shape_distances,
)

Floats = NDArray[np.float64]
DEFAULTS = {
    "views": 40,
    "rounds": 7,
    "threads": 1,
    "accuracy_views": 100,
    "accuracy_queries": 40,
    "growth": True,
    "out": "",
}
_ALWAYS = float("inf")
_CHI2 = PairCost(compare="chi2")
OURS = {
    "nearest, Hellinger": Matching(),
    "nearest, Hellinger, both sides": Matching(method=Nearest(sides="sum", keep=1.0)),
    "nearest, exact chi2": Matching(cost=_CHI2),
    "Sinkhorn, 20 iterations, all views": Matching(method=Sinkhorn(iterations=20, tolerance=_ALWAYS)),
    "Hungarian, exact best view": Matching(method=Hungarian()),
    "Hungarian, all views": Matching(method=Hungarian(exact=None)),
}
#: From lists of points through the library's one call: packing and describing the views included.
_RAW = "nearest, Hellinger, from raw lists"
_OPENCV = "OpenCV shape context, iterations "


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(settings["threads"])
    report = Report("matching", {k: v for k, v in settings.items() if k != "out"})
    rivals, missing = rival_methods.available()
    for name, reason in missing.items():
        report.skip(name, reason)
    for points in (100, 300):
        speed(report, rivals, points, settings["views"], settings["rounds"])
    for data in accuracy_sets(settings["accuracy_queries"], settings["accuracy_views"]):
        accuracy(report, rivals, data)
    sampling(report)
    if settings["growth"]:
        growth(report, settings["rounds"])
    report.finish(settings["out"])
    return 0


def speed(report: Report, rivals: dict[str, rival_methods.Rival], points: int, views: int, rounds: int) -> None:
    """Milliseconds for one query, its descriptor included, against `views` views, and how often faster."""
    curves = drawn_shapes.closed_curves(views + 1, points)
    query, database = curves[0], list(curves[1:])
    calls: dict[str, Callable[[], Any]] = {}
    for name, settings in OURS.items():
        calls[name] = partial(prepared(database, settings).distances, torch.from_numpy(query).float())
    calls[_RAW] = partial(shape_distances, [query], database)
    pot = _pot(query, database, report)
    calls |= {"POT Sinkhorn, 20 iterations": pot} if pot else {}
    few = database[: max(1, views // (1 if points < 200 else 8))]
    for name, rival in rivals.items():
        calls[name] = partial(rival, query, few)
    repeats = {name: 5 for name in (*OURS, _RAW) if "Hungarian, all" not in name and "chi2" not in name}
    times = time_interleaved(calls, rounds, repeats=repeats)
    scale = {name: views / len(few) for name in rivals}
    group = f"One query against {views} views, {points} points, descriptor included"
    for name, samples in times.items():
        note = f"timed on {len(few)} views and scaled" if scale.get(name, 1) > 1 else ""
        report.add(group, name, "ms", [t * scale.get(name, 1) for t in samples], note)
    for iterations in (3, 1):
        rival_times = times.get(f"{_OPENCV}{iterations}", [])
        for name in (*OURS, _RAW) if rival_times else ():
            ratios = [r * views / len(few) / own for own, r in zip(times[name], rival_times, strict=True)]
            report.add(f"Times faster than OpenCV's {iterations} iterations, {points} points", name, "x", ratios)


def prepared(database: Sequence[Floats], settings: Matching) -> Matcher:
    """A matcher for point sets (N, 2)."""
    packed = pack(database)
    return Matcher(packed.points, packed.mask, settings=settings)


def _pot(query: Floats, database: Sequence[Floats], report: Report) -> Callable[[], Any] | None:
    """POT's Sinkhorn on our costs, one view after the other."""
    try:
        import ot  # type: ignore[import-untyped]
    except ImportError:
        report.skip("POT Sinkhorn", "needs POT")
        return None
    matcher = prepared(database, Matching())
    asked = matcher.views.query(torch.from_numpy(query).float(), None, None)
    costs = matcher.views.costs_of(asked, torch.arange(len(database))).double().numpy()
    even = np.full(len(query), 1 / len(query))

    def run() -> None:
        for v in range(costs.shape[1]):
            ot.sinkhorn(even, even, costs[:, v], 0.05, numItermax=20, stopThr=0, warn=False)

    return run


@dataclass(frozen=True, slots=True)
class AccuracySet:
    """Queries and views (N, 2) each, with the label that a query's first neighbor should have."""

    name: str
    queries: list[Floats]
    wanted: NDArray[np.int64]
    views: list[Floats]
    labels: NDArray[np.int64]


def accuracy_sets(queries: int, views: int) -> list[AccuracySet]:
    """The same view seen again, whole or in part, and another silhouette of the same class."""
    database = list(drawn_shapes.edge_views(views, 100, seed=1))
    wanted, labels = np.arange(queries) % views, np.arange(views)
    out = []
    for keep, clutter in ((1.0, 0), (0.7, 0), (1.0, 30), (0.7, 30), (0.5, 0)):
        rng = np.random.default_rng(7)
        asked = [drawn_shapes.observe(database[i], rng, keep, clutter) for i in wanted]
        out.append(
            AccuracySet(f"same view, {keep:.0%} of the edge, {clutter} clutter", asked, wanted, database, labels)
        )
    return [*out, _class_set(queries, views)]


def _class_set(queries: int, views: int) -> AccuracySet:
    """Silhouettes in classes, ten of each in the database, others of the class as queries."""
    classes = max(2, -(-views // 10))
    spare = -(-queries // classes)
    shapes = [outline(image, 100).points for _, image in drawn_shapes.silhouettes(classes, 10 + spare, upright=True)]
    label, number = np.divmod(np.arange(len(shapes)), 10 + spare)
    asked = np.flatnonzero(number >= 10)[:queries]
    kept = np.flatnonzero(number < 10)
    name = "same class of upright silhouettes"
    return AccuracySet(name, [shapes[i] for i in asked], label[asked], [shapes[i] for i in kept], label[kept])


def accuracy(report: Report, rivals: dict[str, rival_methods.Rival], data: AccuracySet) -> None:
    """First-neighbor accuracy of everything on one set."""
    methods = dict(rivals)
    for own, settings in OURS.items():
        methods[own] = partial(_own_distances, prepared(data.views, settings))
    for name in (*OURS, *rivals):
        nearest = [int(np.argmin(methods[name](q, data.views))) for q in data.queries]
        hits = data.labels[nearest] == data.wanted
        report.add(f"First neighbor: {data.name}", name, "%", [100 * float(hits.mean())], n=len(hits))


def _own_distances(matcher: Matcher, query: Floats, views: Sequence[Floats]) -> Floats:
    return matcher.distances(torch.from_numpy(query).float()).numpy()


def sampling(report: Report, views: int = 200, queries: int = 60) -> None:
    """First-neighbor accuracy and sampling time against the number of points, by way of sampling."""
    dense = drawn_shapes.edge_views(views, 800, seed=3)
    matching = Matching(descriptor=ShapeContext(scale=60.0))
    for count in (25, 50, 100, 200):
        for method in METHODS:
            calls = {method: partial(sample, np.round(dense[0]), count, method)}
            times = time_interleaved(calls, 5)[method]
            database = [v[sample(v, count, method)] for v in np.round(dense)]
            matcher, rng, hits = prepared(database, matching), np.random.default_rng(5), 0
            for i in range(queries):
                seen = np.round(np.vstack([drawn_shapes.observe(dense[i], rng, 0.7), _strokes(rng, 240)]))
                query = seen[sample(seen, count, method)]
                hits += int(matcher.distances(torch.from_numpy(query).float()).argmin()) == i
            note = f"{np.median(times):.1f} ms to sample one picture of 800 points"
            group = f"Sampling: first neighbor of {views} views, 70 % of the edge, 30 % clutter strokes"
            report.add(group, f"{count} points, {method}", "%", [100 * hits / queries], note, n=queries)


def _strokes(rng: np.random.Generator, count: int, length: int = 20) -> Floats:
    """Clutter (count, 2) px as what is left after small parts are taken out: short straight strokes."""
    angle = rng.uniform(0, np.pi, (count // length, 1))
    along = np.arange(length) - length / 2
    places = rng.uniform(20, 230, (count // length, 1, 2))
    return (places + np.stack([along * np.cos(angle), along * np.sin(angle)], -1)).reshape(-1, 2)


def growth(report: Report, rounds: int) -> None:
    """Exhaustive Hellinger search of 400 and 4,000 views beside the matrix-product peak of the same rounds."""
    curves = drawn_shapes.closed_curves(4001, 100, seed=2)
    query = torch.from_numpy(curves[0]).float()
    small, large = (prepared(list(curves[1 : v + 1]), Matching()) for v in (400, 4000))
    square = torch.rand(2048, 2048)
    out = torch.empty_like(square)
    calls = {
        "400 views": lambda: small.distances(query),
        "4,000 views": lambda: large.distances(query),
        "matrix product of 2,048": lambda: torch.mm(square, square, out=out),
    }
    times = time_interleaved(calls, rounds, warm_up=2)
    group = "Growth of the exhaustive Hellinger search, 100 points"
    for name, samples in times.items():
        report.add(group, name, "ms", samples)
    pairs = zip(times["400 views"], times["4,000 views"], strict=True)
    report.add(group, "4,000 views over 400 views", "x", [b / a for a, b in pairs])
    work, peak = 2 * 100 * 100 * 60 * 4000, 2 * 2048**3
    rates = zip(times["4,000 views"], times["matrix product of 2,048"], strict=True)
    shares = [100 * (work / a) / (peak / b) for a, b in rates]
    report.add(group, "4,000 views, share of the matrix-product peak", "%", shares)
