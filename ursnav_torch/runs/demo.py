"""The whole job without data or devices: a phantom's VID, simulated pictures, matches, a page."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.columns import TRUTH_COLUMNS
from ursnav_torch.files import Progress, no_progress, whole_folder, write_csv, write_image
from ursnav_torch.geometry import angle_between
from ursnav_torch.localization import LEARNED_FROM, Localizer, Query, simulated_queries
from ursnav_torch.runs.match import match_images
from ursnav_torch.vid import MakeRenderer, PlanSettings, Vid, pose_cells


@dataclass(frozen=True, slots=True)
class PresetScore:
    """How the pictures of one kind of sensor faults were located.

    Attributes:
        preset: its name.
        pictures, right, accepted, accepted_right: counts.
        position_mm, direction_deg: median errors.
    """

    preset: str
    pictures: int
    right: int
    accepted: int
    accepted_right: int
    position_mm: float
    direction_deg: float


def run_demo(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    pictures_per_calyx: int,
    out: Path,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> list[PresetScore]:
    """Draw pictures of the VID's kidney with sensor faults, locate them, and write all of it to a folder.

    ``out`` gets ``images/``, ``truth.csv``, ``matches.csv`` and ``report/index.html``.

    Args:
        vid: a VID.
        make_renderer: called as ``make_renderer(mesh, camera)``.
        plan: how its views were planned; the pictures' poses are planned alike with another seed.
        pictures_per_calyx: pictures of each calyx; the kinds of sensor faults, the widened ones among them, take turns.
        out: folder to be made.
        overwrite: replace what stands there.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
    """
    with whole_folder(out, overwrite, resume=True) as work:
        queries = _draw_queries(vid, make_renderer, plan, pictures_per_calyx, work, progress)
        truth = {name: vid.calyx_name(q.calyx) for name, q in queries.items()}
        rows = match_images(
            Localizer(vid), str(work / "images"), work / "matches.csv", work / "report", True, progress, truth
        )
    return _scores(vid, queries, rows)


def _draw_queries(
    vid: Vid, make_renderer: MakeRenderer, plan: PlanSettings, pictures_per_calyx: int, work: Path, progress: Progress
) -> dict[str, Query]:
    """The pictures by name, written to ``images/``, and ``truth.csv``."""
    images = work / "images"
    shutil.rmtree(images, ignore_errors=True)  # of an interrupted run: its pictures need not be these
    images.mkdir()
    alike = replace(plan, views_per_calyx=pictures_per_calyx, passage_views=0, seed=plan.seed + 2)
    rng = np.random.default_rng(alike.seed)
    queries = {}
    with progress(pictures_per_calyx * len(vid.kidney.calyces), "pictures drawn") as advance:
        for i, query in enumerate(simulated_queries(vid, make_renderer, alike, rng, LEARNED_FROM)):
            queries[f"{i:03d}_{query.preset}.png"] = query
            write_image(images / f"{i:03d}_{query.preset}.png", query.image)
            advance(1)
    write_csv(work / "truth.csv", (*TRUTH_COLUMNS, "preset"), [_truth_row(vid, name, q) for name, q in queries.items()])
    return queries


def _truth_row(vid: Vid, name: str, query: Query) -> dict[str, Any]:
    pose = pose_cells(query.T_kidney_camera[None])[0]
    return {"image": name, "calyx": vid.calyx_name(query.calyx), **pose, "preset": query.preset}


def _scores(vid: Vid, queries: dict[str, Query], rows: list[dict[str, Any]]) -> list[PresetScore]:
    scores = []
    for preset in dict.fromkeys(q.preset for q in queries.values()):
        own = [(queries[r["image"]], r) for r in rows if queries[r["image"]].preset == preset]
        located = [(q, r) for q, r in own if not r.get("error")]
        right = [r["calyx"] == vid.calyx_name(q.calyx) for q, r in located]
        sure = [bool(r["accepted"]) for _, r in located]
        position = [np.linalg.norm([r["x_mm"], r["y_mm"], r["z_mm"]] - q.T_kidney_camera[:3, 3]) for q, r in located]
        axes = [_axis(r) for _, r in located]
        direction = [
            np.degrees(angle_between(a, q.T_kidney_camera[:3, 2])) for a, (q, _) in zip(axes, located, strict=True)
        ]
        both = sum(a and b for a, b in zip(right, sure, strict=True))
        medians = [float(np.median(v)) if v else float("nan") for v in (position, direction)]
        scores.append(PresetScore(preset, len(own), sum(right), sum(sure), both, *medians))
    return scores


def _axis(row: dict[str, Any]) -> np.ndarray:
    """Viewing direction (3,) of a row's quaternion."""
    x, y, z, w = (row[k] for k in ("qx", "qy", "qz", "qw"))
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
