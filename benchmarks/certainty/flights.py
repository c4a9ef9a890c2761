"""Flights through the phantoms, tracked: which calyces were left, and how far off poses were, beside the truth."""

import json
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.certainty.population import ROOMS, RaycastRenderer, current_settings, vid_of_phantom
from benchmarks.shared.fingerprints import sources
from benchmarks.shared.results import Report
from benchmarks.tracking import fly
from ursnav_torch.files import write_json
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.localization import LEARNED_FROM
from ursnav_torch.localization.certainty import LEVELS
from ursnav_torch.localization.fitting import fit_quantile
from ursnav_torch.localization.learned import PositionErrors, TrackWeights
from ursnav_torch.rendering.sensor import draw_faults, simulate
from ursnav_torch.tracking.certainty import TrackEvidence, track_certainty
from ursnav_torch.tracking.tracker import TRACKING, Tracker
from ursnav_torch.vid import Vid

#: Kinds of pictures flown with, phantoms in turn.
KINDS = ("wide", "in_vivo_like", "thesis_phantom")
#: A conformal level that the learned shares never go below: a calyx that nearly nothing speaks for is out.
_LEAST = 1e-3


def learn_track(report: Report, learned_on: Sequence[int], judged: Sequence[int], settings: dict[str, Any],
                work: Path) -> TrackWeights:  # fmt: skip
    """Weights from the flights of some phantoms, judged on those of others."""
    pictures, views = settings["flight"], settings["views"]
    learning, judging = (
        list(chain.from_iterable(_rows(seed, pictures, views, work) for seed in seeds))
        for seeds in (learned_on, judged)
    )
    weights = fit_track(learning)
    _tell(report, judging, weights, settings["probability"])
    return weights


def fit_track(rows: Sequence[dict[str, Any]]) -> TrackWeights:
    """Weights of errors, and conformal shares at `LEVELS`."""
    found = [_evidence(row) for row in rows]
    away, turned = (np.stack(column) for column in zip(*(e.error_numbers() for e in found), strict=True))
    mm, deg = (np.log(np.array([row[key] for row in rows]) + small) for key, small in (("mm", 0.02), ("deg", 0.1)))
    position, direction = (fit_quantile(basis, errors) for basis, errors in ((away, mm), (turned, deg)))
    own = np.sort(
        [np.inf if e.calyx == row["true"] else e.share[row["true"]] for e, row in zip(found, rows, strict=True)]
    )
    rank = [int(np.floor((len(own) + 1) * (1 - level))) - 1 for level in LEVELS]
    shares = tuple(float(np.clip(own[max(r, 0)], _LEAST, 0.5)) for r in rank)
    region_sd = float(np.quantile(np.array([row["mm"] for row in rows]) / np.exp(away @ position), 0.9))
    errors = PositionErrors(_three(position), round(region_sd, 3))  # no robot was heard: its word changes nothing
    return TrackWeights(shares, errors, errors, _three(direction))


def _rows(seed: int, pictures: int, views: int, work: Path) -> list[dict[str, Any]]:
    """Plain rows of one phantom's flight, from the work folder where they lie there already."""
    path = work / f"certainty_flight_{seed:03d}_{views}_{pictures}.json"
    came_from = current_settings() + sources((*ROOMS, "tracking"))
    if path.exists():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept.get("came_from") == came_from:
            return list(kept["rows"])
    rows = _flown(vid_of_phantom(seed, views, work), seed, pictures)
    write_json(path, {"came_from": came_from, "rows": rows})
    print(f"phantom {seed}: {len(rows)} pictures of a flight tracked", file=sys.stderr, flush=True)
    return rows


def _flown(vid: Vid, seed: int, pictures: int) -> list[dict[str, Any]]:
    rng, renderer = np.random.default_rng(90_000 + seed), RaycastRenderer(vid.kidney.mesh, vid.camera)
    T = fly(vid.kidney, range(0, 4, 2), rng, 0.8)[:pictures]
    true = observed_calyx(T, vid.kidney, vid.lumen).tolist()
    faults, tracker = draw_faults(LEARNED_FROM[KINDS[seed % len(KINDS)]], rng), Tracker(vid)
    rows = []
    for i, (pose, calyx) in enumerate(zip(T, true, strict=True)):
        found = tracker.step(simulate(renderer, pose, faults, rng), i / 10)
        if found.state == TRACKING and found.certainty is not None and found.T_kidney_camera is not None:
            e, at = found.certainty.evidence, found.T_kidney_camera
            turned = float(np.degrees(angle_between(at[:3, 2], pose[:3, 2])))
            rows.append({
                "calyx": e.calyx, "share": e.share.round(4).tolist(), "score": e.score, "spread_mm": e.spread_mm,
                "spread_deg": e.spread_deg, "true": calyx, "deg": turned,
                "mm": float(np.linalg.norm(at[:3, 3] - pose[:3, 3])) / vid.kidney.scale,
            })  # fmt: skip
    return rows


def _tell(report: Report, rows: Sequence[dict[str, Any]], weights: TrackWeights, probability: float) -> None:
    told = [track_certainty(_evidence(row), weights, weights.position, probability, 1.0) for row in rows]
    group, count = "track: phantoms never seen", len(rows)
    for name, values in (
        ("right calyx", [t.calyces[0] == row["true"] for t, row in zip(told, rows, strict=True)]),
        ("set holds the right calyx", [row["true"] in t.calyces for t, row in zip(told, rows, strict=True)]),
        ("position within one sd", [row["mm"] <= t.position_sd_mm for t, row in zip(told, rows, strict=True)]),
        ("direction within one sd", [row["deg"] <= t.direction_sd_deg for t, row in zip(told, rows, strict=True)]),
    ):
        report.add(group, name, "%", [100 * float(np.mean(values))], n=count)
    report.add(group, "mean size of the set", "calyces", [float(np.mean([len(t.calyces) for t in told]))], n=count)


def _evidence(row: dict[str, Any]) -> TrackEvidence:
    share = np.array(row["share"])
    return TrackEvidence(row["calyx"], share, row["score"], row["spread_mm"], row["spread_deg"])


def _three(weights: np.ndarray) -> tuple[float, float, float]:
    a, b, c = (float(f"{w:.5g}") for w in weights)
    return a, b, c
