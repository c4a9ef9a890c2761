"""Screening of large VIDs by the product's own way: ``python -m benchmarks.screening vid=DIR pictures=200``.

Simulated pictures are located twice, by the search in two stages and by the exhaustive one, in turns: how often both
name the same calyx and places within 0.3 mm, refined and not, and what a picture takes. A VID that is large enough to
have a screen is also opened in a process of its own and locates the pictures there: seconds, memory and bytes. For one
that is not, ``tiled=100000`` stores its views again and again up to that number and opens that; what it answers is not
looked at, since views come again. Beside what a clock says stands what the processor worked, which a busy machine
changes less. A real VID of 100,000 views: ``python -m benchmarks.building views=100000 work=DIR``.

Arguments, each ``key=value``: ``vid=DIR`` (a phantom's of ``views=2000`` is built where it is left out)
``pictures=200`` ``tiled=0`` ``threads=2`` ``seed=1`` ``work=DIR`` ``out=FILE.json``.
"""

import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import fields, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.building import build
from benchmarks.shared.results import Report, errors_told, overrides
from ursnav_torch.errors import FeatureError
from ursnav_torch.localization import Localizer
from ursnav_torch.localization.answers import Judgement
from ursnav_torch.localization.learn import queries_from
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import PlanSettings, Vid, ViewFeatures, load_vid, make_screen, plan_views, save_vid

DEFAULTS = {"vid": "", "views": 2000, "pictures": 200, "tiled": 0, "threads": 2, "seed": 1, "work": "", "out": ""}
#: Places within this of each other are the same, mm at the kidney's scale 1.
SAME_MM = 0.3
#: Pictures that the tiled VID locates, and what is said of it.
_TIMED, _TILED = 20, " (views come again: for time and memory alone)"
Images = list[NDArray[np.uint8]]
#: By the clock and of the processor.
Seconds = tuple[float, float]


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(settings["threads"])
    report = Report("screening", {k: v for k, v in settings.items() if k not in ("out", "work", "vid")})
    with ExitStack() as stack:
        work = Path(settings["work"] or stack.enter_context(tempfile.TemporaryDirectory()))
        folder = Path(settings["vid"]) if settings["vid"] else work / "vid"
        if not settings["vid"]:
            build({"views": settings["views"], "workers": settings["threads"], "compute": "local"}, folder)
        vid = load_vid(folder)
        images = simulated(vid, settings["pictures"], settings["seed"])
        if vid.screen is not None:
            measure_opened(report, folder, images, settings["threads"])
        if settings["tiled"]:
            tile(vid, settings["tiled"], work / "tiled")
            measure_opened(report, work / "tiled", images[:_TIMED], settings["threads"], _TILED)
        compare(report, vid, images)
    report.finish(settings["out"])
    return 0


def simulated(vid: Vid, count: int, seed: int) -> Images:
    """``count`` pictures with the sensor presets' faults, evenly from places before the calyces that no view has."""
    plan = plan_views(vid.kidney, vid.lumen, PlanSettings(views_per_calyx=-(-count // len(vid.kidney.calyces)),
                                                          passage_views=0, seed=seed + 9000))  # fmt: skip
    chosen = np.random.default_rng(seed).permutation(len(plan.calyx))[:count]
    make = partial(RaycastRenderer, light=HeadLight())
    rng = np.random.default_rng(seed)
    return [q.image for q in queries_from(vid, make, plan.T_kidney_camera[chosen], plan.calyx[chosen], rng)]


def compare(report: Report, vid: Vid, images: Images) -> None:
    """Both searches on the same pictures, in turns."""
    screened = Localizer(replace(vid, screen=vid.screen or make_screen(vid.features)))
    exhaustive = Localizer(replace(vid, screen=None))
    agree: dict[str, list[bool]] = {"refined": [], "unrefined": []}
    taken: dict[str, list[Seconds]] = {"two stages": [], "exhaustive": []}
    for image in images:
        try:
            features = screened.features(image)
        except FeatureError:
            continue
        found = []
        for name, localizer in (("two stages", screened), ("exhaustive", exhaustive)):
            start = now()
            with torch.inference_mode(), one_thread_an_operation():
                found.append(localizer.judge(features))
            taken[name].append(since(start))
        for kind, alike in agree.items():
            alike.append(same_place(screened, found[0], found[1], refined=kind == "refined"))
    group = f"{len(vid):,} views, two stages against exhaustive search"
    for kind, alike in agree.items():
        report.add(
            group, f"same calyx and within {SAME_MM} mm, {kind}", "%", [100 * float(np.mean(alike))], n=len(alike)
        )
    for name, seconds in taken.items():
        _add_times(report, group, f"from features to place, {name}", "ms", seconds)


def same_place(localizer: Localizer, one: Judgement, other: Judgement, refined: bool) -> bool:
    """Whether two answers of a VID are one."""
    pose = localizer.pose if refined else localizer.nearest_pose
    calyces = [(j.calyx if refined else j.voted) for j in (one, other)]
    apart = float(np.linalg.norm(pose(one)[:3, 3] - pose(other)[:3, 3])) / localizer.vid.kidney.scale
    return calyces[0] == calyces[1] and apart <= SAME_MM


def tile(vid: Vid, count: int, folder: Path) -> None:
    """Store a VID of ``count`` views, the same ones again and again, their pictures linked."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    rows = torch.arange(count) % len(vid)
    for number, view in enumerate(rows.tolist()):
        place = folder / "images" / f"{number:06d}.png"
        if not place.exists():
            os.link(vid.image_path(view), place)
    features = ViewFeatures(*(getattr(vid.features, field.name)[rows] for field in fields(ViewFeatures)))
    T, calyx = vid.T_kidney_camera[rows.numpy()], vid.calyx[rows.numpy()]
    tiled = replace(vid, features=features, T_kidney_camera=T, calyx=calyx, folder=folder, screen=make_screen(features))
    save_vid(tiled, folder)


def measure_opened(report: Report, folder: Path, images: Images, threads: int, what: str = "") -> None:
    """What opening a VID and locating pictures in it take, in a process of its own; ``what`` is said of the VID."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        views, opened, ready, located, memory = pool.submit(open_and_locate, folder, images, threads).result()
    group = f"{views:,} views, opened anew{what}"
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e9
    _add_times(report, group, "opening", "s", [opened])
    _add_times(report, group, "opening and making ready", "s", [ready])
    _add_times(report, group, "picture to place, refined", "ms", located)
    report.add(group, f"greatest resident memory, {len(located)} pictures", "GiB", [memory], n=1)
    report.add(group, "on disk", "GB", [size], n=1)


def open_and_locate(folder: Path, images: Images, threads: int) -> tuple[int, Seconds, Seconds, list[Seconds], float]:
    """Views; seconds to a VID, to a localizer, of each picture; greatest resident memory, GiB."""
    torch.set_num_threads(threads)
    start = now()
    vid = load_vid(folder)
    opened = since(start)
    localizer = Localizer(vid)
    ready, located = since(start), []
    for image in images:
        start = now()
        try:
            localizer.locate(image)
        except FeatureError:
            continue
        located.append(since(start))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return len(vid), opened, ready, located, memory


def now() -> Seconds:
    """The clock's and the processor's seconds."""
    return time.perf_counter(), time.process_time()


def since(start: Seconds) -> Seconds:
    """Seconds since `now` said ``start``."""
    clock, processor = now()
    return clock - start[0], processor - start[1]


def _add_times(report: Report, group: str, name: str, unit: str, taken: list[Seconds]) -> None:
    scale = 1e3 if unit == "ms" else 1.0
    for column, what in enumerate(("", ", of a processor")):
        report.add(group, name + what, unit, [scale * seconds[column] for seconds in taken])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
