"""What shape contexts and an assignment add to a search's finalists: ``python -m benchmarks.finalists work=DIR``.

Every way of matching sees the same finalists of the same pictures, at the same rolls and tilts. "shapes alone" ranks
them by shape distance alone; "with maps" as `match` does, unrefined, at the weight of shapes that was best for that way
on the choosing phantoms. The default of `search.default_matching` and `SearchSettings.shape_weight` are chosen by the
choosing half; the judging half shows what to expect of it.

Arguments, each ``key=value``: ``work=DIR`` (keeps the VIDs) ``phantoms=3`` (of each half) ``views=60`` ``pictures=24``
(a calyx, the kinds of `benchmarks.certainty` taking turns) ``features=default`` (or ``rims``, or
``default,rims``: whose points are compared) ``ways=`` (those whose name begins so; all when empty) ``out=FILE.json``.

Notes on what was tried, one after another, on finalists of pictures drawn as this suite draws them; no command prints
these figures now, but those of rims on 600 judging pictures. The edge points are the limit, not how they are compared.
Share right by shapes alone, phantom 3200:

* the points of the true view in place of the picture's (200 pictures): 94 %, 96 % both sides, 96 % with maps. Of a true
  view's edge pixels, the picture shows within 2 px 89 % (``thesis_simulation``), 75 % (``thesis_phantom``), 42 %
  (``in_vivo_like``) and 33 % (``wide``), 15 to 19 % by chance; of the picture's, the view shows 72, 56, 33 and 27 %.
  Over all kinds, within 2 px and 30°, 37 % repeat of those without a depth step and 51 to 53 % of those with one of 0.5
  or more in log depth; 22 % of weak ones (strength 0.3 to 0.4) and 52 % of strong ones (0.8 to 1). Canny finds both
  flanks of each dark rim, bubbles, highlights and what stands before the wall;
* other shape contexts in the default cost (100 pictures, 69 % with 40 px): reach of 20, 80 or 125 px: 65, 64, 60 %;
  bins split by edge direction, 40 or 80 px: 64, 68 %, by direction and brighter side: 66, 70 %; neighbors weighed by
  strength: 69 %; frames radial or tangent: 67, 66 %;
* costs without shape contexts: position within 60 px and direction 59 %, within 10, 15, 20 or 30 px 62 to 66 %; with
  the brighter side in place of the direction 62 to 66 %. None added to the maps;
* lines of dark rims, ridges of the relief's curvature smoothed by 1.2 px at the working size, in place of Canny's
  edges: the one that won. Alone and both sides, 80 % where edges had 66 % (200 pictures). Smoothed by 1.8, 2.6 or
  3.5 px: 80, 78, 75 %; bright ridges as well: 76 %. They are `features.RimSettings` now, thinned and masked by the
  package's own means. ``features=default,rims ways=nearest``, 600 judging pictures: alone 72.7 % (76.5 both sides)
  where edges have 64.5 (67.2); with maps at the best weights 82.8 (83.5) where edges have 82.3 (82.8) and maps alone
  were right on 82.2 % of the choosing half. Beside the maps the gain is within chance, so edges stay the default;
  how sure answers are the package has not learned with rims, a VID alone when it is built.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.certainty.population import kinds
from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.shared.statistics import wilson
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import DefaultSettings, Features, RimSettings, Settings
from ursnav_torch.kidney import make_phantom_kidney, observed_calyx
from ursnav_torch.localization import Query, simulated_queries
from ursnav_torch.localization.evidence import vote
from ursnav_torch.matching import Hungarian, Matching, Nearest, Sinkhorn
from ursnav_torch.matching.methods.base import Method
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import Ranking, SearchSettings, ViewSearch, default_matching
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import PlanSettings, Vid

DEFAULTS = {"work": "", "phantoms": 3, "views": 60, "pictures": 24, "features": "default", "ways": "", "out": ""}
#: Features whose points are compared.
FEATURES: dict[str, Settings] = {"default": DefaultSettings(), "rims": RimSettings()}
#: Phantoms from these seeds on choose and judge; `benchmarks.certainty` and the network learn from others.
CHOOSING_SEED, JUDGING_SEED = 3200, 3300
#: Weights of the shape distance that are tried; the maps' are 3 together.
SHAPE_WEIGHTS = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0)
CHOOSING, JUDGING = "choosing", "judging"


@dataclass(frozen=True, slots=True)
class Answered:
    """One picture, one way: whether the calyx is right by shapes alone and with maps at every weight, and the time."""

    half: str
    kind: str
    alone: bool
    right: tuple[bool, ...]
    seconds: float


def ways() -> dict[str, Matching]:
    """The ways of matching that are compared."""
    base = default_matching()
    methods: dict[str, Method] = {"nearest": Nearest(keep=1.0), "nearest, both sides": Nearest("sum", keep=1.0),
                                  "hungarian": Hungarian()}  # fmt: skip
    found = {name: replace(base, method=method) for name, method in methods.items()}
    for dummy in (None, 0.1, 0.15, 0.2, 0.3):
        for epsilon in (0.02, 0.05):
            name = f"sinkhorn, epsilon {epsilon}, " + ("no dummies" if dummy is None else f"dummies at {dummy}")
            method = Sinkhorn(epsilon, iterations=20, tolerance=float("inf"), dummy_cost=dummy)
            found[name] = replace(base, method=method)
    return found


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the phantoms' VIDs")
    asked = settings["features"].split(",")
    compared = {name: way for name, way in ways().items() if name.startswith(settings["ways"])}
    if not compared or not set(asked) <= set(FEATURES):
        raise InputError(f"features are {', '.join(FEATURES)}, ways are {'; '.join(ways())}.")
    report = Report("finalists", {k: settings[k] for k in ("phantoms", "views", "pictures", "features", "ways")})
    for features in asked:
        answers: dict[str, list[Answered]] = {name: [] for name in compared}
        for half, seed in halves(settings["phantoms"]):
            vid = _vid(work, seed, settings["views"], features)
            ask(vid, half, seed, settings["pictures"], compared, answers)
            print(f"{features}, {half}: phantom {seed} done", file=sys.stderr, flush=True)
        for name, own in answers.items():
            score(report, name if features == "default" else f"{features}: {name}", own)
    report.finish(settings["out"])
    return 0


def halves(phantoms: int) -> list[tuple[str, int]]:
    """The phantoms' seeds, so many of each half, and which half it is."""
    firsts = ((CHOOSING, CHOOSING_SEED), (JUDGING, JUDGING_SEED))
    return [(half, seed) for half, first in firsts for seed in range(first, first + phantoms)]


def _vid(work: Path, seed: int, views: int, features: str) -> Vid:
    name = f"finalists_{seed}_{views}" + ("" if features == "default" else f"_{features}")
    plan = PlanSettings(views_per_calyx=views, passage_views=views)
    return phantom_vid(make_phantom_kidney(seed), plan, work / name, settings=FEATURES[features])


def ask(
    vid: Vid, half: str, seed: int, pictures: int, compared: dict[str, Matching], answers: dict[str, list[Answered]]
) -> None:
    """Answers of the ways to simulated pictures of one phantom, added to those each has."""
    search = ViewSearch(vid, SearchSettings(shape_weight=0.0))
    by_shape = {name: ViewSearch(vid, SearchSettings(shape_weight=1.0), way) for name, way in compared.items()}
    plan = PlanSettings(pictures, 0, nearest_mm=3.0, farthest_mm=11.0, tilt_deg=8.0, roll_deg=180.0, seed=seed)
    extractor = vid.extractor()
    for query in simulated_queries(vid, RaycastRenderer, plan, np.random.default_rng(seed), kinds()):
        with torch.inference_mode(), one_thread_an_operation():
            try:
                features = extractor.extract(query.image)
            except FeatureError:
                continue
            finalists = search.rank(features)
            for name, way in by_shape.items():
                answers[name].append(_answered(vid, half, way, features, finalists, query))


def _answered(vid: Vid, half: str, way: ViewSearch, features: Features, finalists: Ranking, query: Query) -> Answered:
    start = time.process_time()
    found = way.with_shapes(features, finalists)
    seconds = time.process_time() - start
    assert found.assignment is not None
    calyces = observed_calyx(found.T_kidney_camera, vid.kidney, vid.lumen)
    alone = found.assignment.distance.numpy().astype(float)
    right = []
    for weight in SHAPE_WEIGHTS:
        similarity = (finalists.score + weight * (1 - alone)) / (finalists.best_score + weight)
        order = np.argsort(-similarity, kind="stable")
        said = vote(1 - similarity[order], calyces[order], len(vid.kidney.calyces))
        right.append(said.calyx == query.calyx)
    return Answered(half, query.preset, calyces[alone.argmin()] == query.calyx, tuple(right), seconds)


def score(report: Report, name: str, answers: list[Answered]) -> None:
    """Rows of one way: its best weight on the choosing half, and what is right on both, by kind on the judging half."""
    by_weight = np.mean([a.right for a in answers if a.half == CHOOSING], axis=0)
    best = int(by_weight.argmax())
    for half in (CHOOSING, JUDGING):
        own = [a for a in answers if a.half == half]
        _row(report, f"{half}: shapes alone", name, [a.alone for a in own])
        _row(report, f"{half}: with maps", name, [a.right[best] for a in own], f"weight {SHAPE_WEIGHTS[best]:g}, ")
    for i, weight in enumerate(SHAPE_WEIGHTS):
        _row(
            report,
            f"{CHOOSING}: shapes at weight {weight:g}",
            name,
            [a.right[i] for a in answers if a.half == CHOOSING],
        )
    for kind in sorted({a.kind for a in answers}):
        own = [a for a in answers if a.half == JUDGING and a.kind == kind]
        _row(report, f"{JUDGING}, {kind}: with maps", name, [a.right[best] for a in own])
    report.add("shape stage, 32 finalists", name, "ms", [1e3 * a.seconds for a in answers], "CPU time")


def _row(report: Report, group: str, name: str, right: Sequence[bool], note: str = "") -> None:
    low, high = wilson(sum(right), len(right))
    note += f"{sum(right)}/{len(right)}, 95 % interval {100 * low:.0f} to {100 * high:.0f} %"
    report.add(group, name, "%", [100 * float(np.mean(right))], note, len(right))
