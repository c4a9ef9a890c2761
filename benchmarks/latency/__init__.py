"""From picture to pose, and building a VID, in seconds and bytes: ``python -m benchmarks.latency``.

Arguments, each ``key=value``: ``vid=DIR`` (a VID; a phantom's is built and timed when left out) ``views=2000``
``pictures=60`` ``threads=2`` ``workers=0`` (processes for the build; 0 takes all cores) ``out=FILE.json``.
"""

import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.shared.results import Report, overrides
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import LocalizationSettings, Localizer, simulated_queries
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid

DEFAULTS = {"vid": "", "views": 2000, "pictures": 60, "threads": 2, "workers": 0, "out": ""}


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(settings["threads"])
    report = Report("latency", {k: v for k, v in settings.items() if k not in ("out", "vid")})
    with tempfile.TemporaryDirectory() as scratch:
        if settings["vid"]:
            vid = load_vid(settings["vid"])
        else:
            vid = _build(report, settings["views"], settings["workers"] or None, Path(scratch) / "vid")
        _start(report, vid)
        _locate(report, vid, settings["pictures"])
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    report.add("memory", "peak of this process", "GiB", [used])
    report.add("memory", "peak of the largest worker", "GiB", [children])
    report.finish(settings["out"])
    return 0


def _build(report: Report, views: int, workers: int | None, out: Path) -> Vid:
    kidney = make_phantom_kidney(seed=0, calyces=8)
    plan = replace(PlanSettings(), views_per_calyx=views // 9, passage_views=views - 8 * (views // 9))
    start = time.perf_counter()
    vid = build_vid(
        kidney,
        equidistant_camera(),
        DefaultSettings(),
        partial(RaycastRenderer, light=HeadLight()),
        plan,
        out,
        workers=workers,
    )
    seconds = time.perf_counter() - start
    report.add("building a VID", f"{len(vid)} views", "s", [seconds], f"{len(vid) / seconds:.0f} views/s")
    return vid


def _start(report: Report, vid: Vid) -> None:
    """What stands between a VID that is read and its first picture: the first start, then four more."""
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        Localizer(vid)
        seconds.append(time.perf_counter() - start)
    report.add("starting a Localizer", f"{len(vid)} views", "s", seconds, f"the first {seconds[0]:.2f} s")


def _locate(report: Report, vid: Vid, pictures: int) -> None:
    plan = replace(PlanSettings(), views_per_calyx=-(-pictures // len(vid.kidney.calyces)), passage_views=0, seed=7)
    make_renderer = partial(RaycastRenderer, light=HeadLight())
    queries = list(simulated_queries(vid, make_renderer, plan, np.random.default_rng(7)))[:pictures]
    choices = {"no refinement": LocalizationSettings(refine=False), "default": LocalizationSettings()}
    for name, settings in choices.items():
        localizer = Localizer(vid, None, settings)
        for query in queries[:5]:
            localizer.locate(query.image)
        for group, work in (("features", localizer.features), ("picture to pose", localizer.locate)):
            whole, worked = [], []
            for query in queries:
                start, begun = time.perf_counter(), time.process_time()
                work(query.image)
                worked.append(1e3 * (time.process_time() - begun))
                whole.append(1e3 * (time.perf_counter() - start))
            what = name if group == "features" else f"{name}, {len(vid)} views"
            report.add(group, what, "ms", whole, f"95th percentile {np.quantile(whole, 0.95):.0f}")
            report.add(group, f"{what}, processor time", "ms", worked)
