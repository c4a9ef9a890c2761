"""Accuracy and confidence over a population of phantoms: ``python -m benchmarks.population``.

Every phantom gets a VID of its own with confidence learned from its own simulated pictures, and is then asked with
others: 3 pictures a calyx and kind of sensor faults, by the nearest views alone and refined. Arguments, each
``key=value``: ``phantoms=20`` ``pictures=3`` ``views=240`` (a calyx) ``work=DIR`` (keeps VIDs and answers;
the same call goes on from there) ``out=FILE.json`` ``compute=local`` (or the address of a Dask scheduler, ``tcp://...``:
its workers take a phantom each, and ``work`` is a folder that all of them share).
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.statistics import auroc, calibration_error, wilson
from ursnav_torch.errors import FeatureError
from ursnav_torch.files import write_json
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import LocalizationSettings, Localizer, Query, learn_confidence, simulated_queries
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, none_pictures
from ursnav_torch.vid import DaskCompute, PlanSettings, Vid

DEFAULTS = {"phantoms": 20, "pictures": 3, "views": 240, "work": "", "out": "", "compute": "local"}
NEAREST, REFINED = HOW = ("nearest views", "refined")


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("population", {k: v for k, v in settings.items() if k not in ("out", "work", "compute")})
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        work.mkdir(parents=True, exist_ok=True)
        _spread(settings, work)
        answers = []
        for seed in range(settings["phantoms"]):
            answers += phantom_answers(seed, settings, work)
            print(f"phantom {seed + 1} of {settings['phantoms']}", file=sys.stderr)
    for how in HOW:
        _score(report, how, [a for a in answers if a["how"] == how])
    report.finish(settings["out"])
    return 0


def _spread(settings: dict[str, Any], work: Path) -> None:
    """Let a cluster answer for the phantoms; its answers are then taken up as those of an interrupted run are."""
    if settings["compute"] == "local":
        return
    compute = DaskCompute(settings["compute"])
    compute.check_folder(work.absolute())
    tasks = [(seed, settings, work.absolute()) for seed in range(settings["phantoms"])]
    for done, _ in enumerate(compute.map(_answer_there, None, tasks)):
        print(f"{done + 1} phantoms answered", file=sys.stderr)


def _answer_there(_: None, seed: int, settings: dict[str, Any], work: Path) -> int:
    return len(phantom_answers(seed, settings, work, workers=1))


def phantom_answers(
    seed: int, settings: dict[str, Any], work: Path, workers: int | None = None
) -> list[dict[str, Any]]:
    """Answers to one phantom's pictures, from the work folder where they lie there already."""
    path = work / f"phantom_{seed:03d}_{settings['views']}_{settings['pictures']}.json"
    if not path.exists():
        plan = PlanSettings(views_per_calyx=settings["views"])
        learn = partial(learn_confidence, make_renderer=RaycastRenderer, plan=plan)
        out = work / f"vid_{seed:03d}_{settings['views']}"
        vid = phantom_vid(make_phantom_kidney(seed=1000 + seed), plan, out, learn, workers)
        write_json(path, {"answers": _ask(vid, plan, settings["pictures"], seed)})
    return list(json.loads(path.read_text(encoding="utf-8"))["answers"])


def _ask(vid: Vid, plan: PlanSettings, pictures: int, seed: int) -> list[dict[str, Any]]:
    """A row for every simulated picture; poses as the scope looks into a calyx: 3 to 11 mm off, 10 degrees of tilt."""
    rng = np.random.default_rng(50_000 + seed)
    alike = replace(
        plan,
        views_per_calyx=pictures * len(PRESETS),
        passage_views=0,
        nearest_mm=3.0,
        farthest_mm=11.0,
        tilt_deg=8.0,
        roll_deg=180.0,
        seed=plan.seed + 77,
    )
    localizers = {how: Localizer(vid, settings=LocalizationSettings(refine=how == REFINED)) for how in HOW}
    rows = []
    for query in simulated_queries(vid, RaycastRenderer, alike, rng):
        rows += [_row(localizer, query) | {"how": how} for how, localizer in localizers.items()]
    renderer = RaycastRenderer(vid.kidney.mesh, vid.camera)
    for image, kind in none_pictures(rng, 6, renderer, vid.T_kidney_camera):
        for how, localizer in localizers.items():
            try:
                accepted = localizer.locate(image).accepted
            except FeatureError:
                accepted = False
            rows.append({"preset": "none", "kind": kind, "accepted": accepted, "how": how})
    return rows


def _row(localizer: Localizer, query: Query) -> dict[str, Any]:
    """One picture's answer beside the truth."""
    row: dict[str, Any] = {"preset": query.preset, "right": False, "confidence": 0.0, "accepted": False}
    try:
        found = localizer.locate(query.image)
    except FeatureError:
        return row
    T = found.T_kidney_camera
    return row | {
        "right": found.calyx == query.calyx,
        "confidence": found.confidence,
        "accepted": found.accepted,
        "position_mm": float(np.linalg.norm(T[:3, 3] - query.T_kidney_camera[:3, 3])),
        "direction_deg": float(np.degrees(angle_between(T[:3, 2], query.T_kidney_camera[:3, 2]))),
    }


def _score(report: Report, how: str, answers: list[dict[str, Any]]) -> None:
    for preset in PRESETS:
        own = [a for a in answers if a["preset"] == preset]
        right, accepted = sum(a["right"] for a in own), [a for a in own if a["accepted"]]
        low, high = wilson(right, len(own))
        note = f"{right}/{len(own)}, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
        report.add(f"{how}: right calyx", preset, "%", [100 * right / len(own)], note, len(own))
        report.add(f"{how}: position error", preset, "mm", [a["position_mm"] for a in own if "position_mm" in a])
        report.add(f"{how}: direction error", preset, "°", [a["direction_deg"] for a in own if "direction_deg" in a])
        good = sum(a["right"] for a in accepted)
        note = f"{good}/{len(accepted)} of the accepted, of {len(own)}"
        share = 100 * good / max(len(accepted), 1)
        report.add(f"{how}: accepted", f"{preset}, accepted", "%", [100 * len(accepted) / len(own)], note, len(own))
        report.add(f"{how}: accepted", f"{preset}, right of the accepted", "%", [share], note, len(accepted))
    asked = [a for a in answers if a["preset"] != "none"]
    confidence, right_ = np.array([a["confidence"] for a in asked]), np.array([a["right"] for a in asked])
    error = calibration_error(confidence, right_)
    report.add(f"{how}: confidence", "expected calibration error", "of 1", [error], n=len(asked))
    report.add(f"{how}: confidence", "AUROC against right", "of 1", [auroc(confidence, right_)], n=len(asked))
    none = [a for a in answers if a["preset"] == "none"]
    refused = sum(not a["accepted"] for a in none)
    report.add(
        f"{how}: pictures of nothing", "refused", "%", [100 * refused / len(none)], f"{refused}/{len(none)}", len(none)
    )
