"""The whole job without data or devices: a phantom's VID, simulated pictures, matches, a page."""

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import TRUTH_COLUMNS
from ursnav_torch.files import Progress, no_progress, whole_folder, write_csv, write_image, write_json
from ursnav_torch.geometry import angle_between
from ursnav_torch.localization import LEARNED_FROM, Localizer, Query, queries_from
from ursnav_torch.locks import locked, partial_path
from ursnav_torch.processes import busy_children, in_order
from ursnav_torch.records import read_json
from ursnav_torch.runs.match import match_images
from ursnav_torch.vid import MakeRenderer, PlanSettings, Vid, load_vid, plan_views, pose_cells

#: Pictures drawn in one go: every kind of faults has its turn in them.
DRAWN_AT_ONCE = 32
#: What a demo was made for; it stays in the result.
_MADE_FOR = "demo.json"


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


def demo_vid(build: Callable[[Path], Vid], out: Path, settings: Mapping[str, Any], overwrite: bool = False) -> Vid:
    """The demo's VID, beside its folder: built, or what the very same demo had built before it was killed.

    Args:
        build: builds it in a folder, and refuses one that stands there unless it may replace it.
        out: the demo's folder; ``demo.json`` in its work in progress says what the VID beside it was built for.
        settings: plain data that changes when the demo does.
        overwrite: whether ``build`` replaces what stands there.

    Raises:
        InputError: a VID of something else stands there; another process does this demo.
    """
    path, mark = out.with_name(out.name + "_vid"), partial_path(out) / _MADE_FOR
    plain = json.loads(json.dumps(settings))
    with locked(out):
        if path.exists() and mark.exists() and read_json(mark, "demo's settings") == plain:
            return load_vid(path)
        mark.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            write_json(mark, plain)
        vid = build(path)
        if overwrite:  # not before: until then the VID of another call stood there
            write_json(mark, plain)
    return vid


def run_demo(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    pictures_per_calyx: int,
    out: Path,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
    workers: int | None = None,
    begin: Callable[[str], None] = lambda what: None,
) -> list[PresetScore]:
    """Draw pictures of the VID's kidney with sensor faults, locate them, and write all of it to a folder.

    ``out`` gets ``images/``, ``truth.csv``, ``matches.csv`` and ``report/index.html``, beside the ``demo.json`` of
    `demo_vid`.

    Args:
        vid: a VID.
        make_renderer: called as ``make_renderer(mesh, camera)``.
        plan: how its views were planned; the pictures' poses are planned alike with another seed.
        pictures_per_calyx: pictures of each calyx; the kinds of sensor faults, the widened ones among them, take turns.
        out: folder to be made.
        overwrite: replace what stands there.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        workers: processes; all cores when None. Results are the same with any number.
        begin: told what is done next.
    """
    with whole_folder(out, overwrite, resume=True) as work:
        begin(f"Drawing {pictures_per_calyx * len(vid.kidney.calyces)} pictures as a ureteroscope would take them")
        queries = _draw_queries(vid, make_renderer, plan, pictures_per_calyx, work, progress, workers)
        truth = {name: vid.calyx_name(q.calyx) for name, q in queries.items()}
        begin("Locating them, and writing a page about each")
        folders = str(work / "images"), work / "matches.csv", work / "report"
        rows = match_images(Localizer(vid), *folders, True, progress, truth, busy_children(workers))
    return _scores(vid, queries, rows)


def _draw_queries(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    pictures_per_calyx: int,
    work: Path,
    progress: Progress,
    workers: int | None,
) -> dict[str, Query]:
    """The pictures by name, written to ``images/``, and ``truth.csv``."""
    images = work / "images"
    shutil.rmtree(images, ignore_errors=True)  # of an interrupted run: its pictures need not be these
    images.mkdir()
    alike = replace(plan, views_per_calyx=pictures_per_calyx, passage_views=0, seed=plan.seed + 2)
    views = plan_views(vid.kidney, vid.lumen, alike)
    firsts = range(0, len(views.calyx), DRAWN_AT_ONCE)
    parts = [(i, views.T_kidney_camera[i : i + DRAWN_AT_ONCE], views.calyx[i : i + DRAWN_AT_ONCE]) for i in firsts]
    queries: dict[str, Query] = {}
    with progress(len(views.calyx), "pictures drawn") as advance:
        for drawn in in_order(partial(_Draughtsman, vid, make_renderer, alike.seed), parts, busy_children(workers)):
            for query in drawn:
                name = f"{len(queries):03d}_{query.preset}.png"
                write_image(images / name, query.image)
                queries[name] = query
                advance(1)
    write_csv(work / "truth.csv", (*TRUTH_COLUMNS, "preset"), [_truth_row(vid, name, q) for name, q in queries.items()])
    return queries


class _Draughtsman:
    """Called with the number of a first pose, poses and calyces: pictures from there, by numbers of their own."""

    def __init__(self, vid: Vid, make_renderer: MakeRenderer, seed: int) -> None:
        self._vid, self._make_renderer, self._seed = vid, make_renderer, seed

    def __call__(self, part: tuple[int, NDArray[np.float64], NDArray[np.int64]]) -> list[Query]:
        first, T, calyces = part
        rng = np.random.default_rng([self._seed, first])
        return list(queries_from(self._vid, self._make_renderer, T, calyces, rng, LEARNED_FROM))


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
