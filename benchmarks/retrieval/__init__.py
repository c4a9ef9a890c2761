"""Retrieval on silhouettes by the standard protocol: ``python -m benchmarks.retrieval data=DIR``.

DIR holds binary PNGs named ``class-number.png``, as MPEG-7 CE-Shape-1 (70 classes of 20) has them. Every shape is
a query against all of them, itself included. 1-NN: the class of the nearest other shape is right. Bull's-eye: of
the shapes of the query's class, the share among the nearest 40 (twice the class's size), the query itself counts.
Without ``data`` a stand-in of the same size is drawn in code.

Further arguments: ``points=100 shortlist=300 seed=0 classes=70 out=FILE.json``.
"""

import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.shared.outlines import Outline, mirrored, outline, read_silhouettes
from benchmarks.shared.rerank import diffuse
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.shapes import silhouettes
from ursnav_torch.errors import InputError
from ursnav_torch.matching import ShapeContext, describe
from ursnav_torch.matching.ordered import Ordered, align_outlines
from ursnav_torch.threads import map_chunks

Floats = NDArray[np.float64]
DEFAULTS = {"data": "", "points": 100, "shortlist": 300, "seed": 0, "classes": 70, "out": ""}
#: The outline's own scale and direction: silhouettes are complete, but of any size and roll.
DESCRIPTOR = ShapeContext(r_inner=0.125, r_outer=2.0, scale="own", frame="tangent")


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its table and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    try:
        shapes = read_silhouettes(Path(settings["data"])) if settings["data"] else None
    except InputError as error:
        print(error, file=sys.stderr)
        return 1
    title = "images of the folder given" if shapes else "stand-in drawn in code, not MPEG-7"
    shapes = shapes or [
        (name.rsplit("-", 1)[0], image) for name, image in silhouettes(settings["classes"], 20, settings["seed"])
    ]
    report = Report("retrieval", {k: v for k, v in settings.items() if k not in ("data", "out")})
    start = time.perf_counter()
    labels = np.unique([name for name, _ in shapes], return_inverse=True)[1]
    outlines = [outline(image, settings["points"]) for _, image in shapes]
    histograms, flipped = descriptors(outlines), descriptors([mirrored(o) for o in outlines])
    told(report, title, "points outlined and described", start, len(shapes))
    coarse, side = nearest_distances(histograms, flipped)
    score(report, title, "shape context, nearest, tangent frame, mirror image tried", coarse, labels)
    told(report, title, "all pairs by nearest", start, len(shapes))
    fine = ordered_distances(histograms, flipped, coarse, side, settings["shortlist"])
    score(report, title, "shape context, points in order", fine, labels)
    told(report, title, "shortlist by points in order", start, len(shapes))
    score(report, title, "the same, re-ranked by neighborhoods (uses the gallery)", -diffuse(fine), labels)
    report.finish(settings["out"])
    return 0


def told(report: Report, title: str, what: str, start: float, count: int) -> None:
    """Add the seconds since `start`."""
    report.add(f"Seconds since the start: {title}", what, "s", [time.perf_counter() - start], n=count)


def descriptors(outlines: Sequence[Outline]) -> Tensor:
    """Roots of shape contexts (V, P, D), whose products are similarities, of outlines of P points."""
    points = torch.from_numpy(np.stack([o.points for o in outlines])).float()
    tangents = torch.from_numpy(np.stack([o.tangents for o in outlines])).float()
    return describe(points, torch.ones(points.shape[:2], dtype=torch.bool), DESCRIPTOR, tangents).sqrt()


def nearest_distances(histograms: Tensor, flipped: Tensor) -> tuple[Floats, NDArray[np.int64]]:
    """Sum of both sides' mean least costs (V, V), and whether the query's mirror image (1) was nearer (V, V)."""
    v, p, d = histograms.shape
    out = torch.empty(2, v, v)
    columns = histograms.view(-1, d).T.contiguous()

    def work(queries: slice) -> None:
        for i in range(queries.start, queries.stop):
            for k, query in enumerate((histograms[i], flipped[i])):
                for start in range(0, v, 20):
                    part = slice(start, min(start + 20, v))
                    similar = (query @ columns[:, part.start * p : part.stop * p]).view(p, -1, p)
                    out[k, i, part] = 2 - similar.amax(2).mean(0) - similar.amax(0).mean(1)

    map_chunks(work, v, max(1, v // 8), float(v) * v * p * p * d)
    best, side = out.min(0)
    return symmetric(best.double().numpy()), side.numpy()


def ordered_distances(
    histograms: Tensor, flipped: Tensor, coarse: Floats, side: NDArray[np.int64], shortlist: int
) -> Floats:
    """Distances (V, V) with the order of points kept, for each query's `shortlist`; the others follow behind."""
    v, p, d = histograms.shape
    count = min(shortlist, v)
    out = np.full((v, v), np.inf)
    settings = Ordered()

    def work(queries: slice) -> None:
        for i in range(queries.start, queries.stop):
            for k, query in enumerate((histograms[i], flipped[i])):
                short = np.argpartition(coarse[i], count - 1)[:count]
                short = short[side[i, short] == k]
                if len(short):
                    rows = histograms[torch.from_numpy(short)].permute(2, 1, 0).reshape(d, -1)
                    cost = (1 - query @ rows).view(p, p, -1)
                    out[i, short] = align_outlines(cost, settings).numpy()

    map_chunks(work, v, max(1, v // 8), float(v) * count * p * p * d)
    known = np.isfinite(out)
    behind = out[known].max() + coarse
    return symmetric(np.where(known, out, behind))


def symmetric(distances: Floats) -> Floats:
    """Mean of both directions."""
    return (distances + distances.T) / 2


def score(report: Report, title: str, name: str, distances: Floats, labels: NDArray[np.int64]) -> None:
    """Add bull's-eye and 1-NN of distances (V, V)."""
    bull, first = bulls_eye(distances, labels), first_neighbor(distances, labels)
    report.add(f"Bull's-eye: {title}", name, "%", [100 * bull], n=len(labels))
    report.add(f"1-NN: {title}", name, "%", [100 * first], n=len(labels))


def bulls_eye(distances: Floats, labels: NDArray[np.int64]) -> float:
    """Share of each class found among the nearest twice-its-size shapes, the query itself counted.

    In a gallery of classes of 20 these are the 40 best, 20 right at most.
    """
    sizes = Counter(labels.tolist())
    found, possible = 0, 0
    for row, label in zip(distances, labels, strict=True):
        nearest = np.argsort(row, kind="stable")[: 2 * sizes[int(label)]]
        found += int((labels[nearest] == label).sum())
        possible += sizes[int(label)]
    return found / possible


def first_neighbor(distances: Floats, labels: NDArray[np.int64]) -> float:
    """Share of shapes whose nearest other shape is of their class."""
    others = distances.copy()
    np.fill_diagonal(others, np.inf)
    return float((labels[others.argmin(1)] == labels).mean())
