"""How accuracy falls as pictures get worse: ``python -m benchmarks.severity vid=DIR picture=severity.png``.

Pictures of a VID's own kidney are drawn with every preset of sensor faults at severities from 0 (clean) to 1 (every
fault at its worst at once) and located. Arguments, each ``key=value``: ``vid=DIR pictures=40 steps=5 picture=FILE.png
out=FILE.json``. The picture shows the share of right calyces with its 95 % interval.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.shared.results import Report, overrides
from benchmarks.shared.statistics import wilson
from ursnav_torch.errors import FeatureError, UrsnavError
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, severity, simulate
from ursnav_torch.vid import Plan, PlanSettings, Vid, load_vid, plan_views

DEFAULTS = {"vid": "", "pictures": 40, "steps": 5, "picture": "", "out": ""}


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its table and write its JSON file and its picture."""
    settings = overrides(DEFAULTS, arguments)
    try:
        vid = load_vid(Path(settings["vid"]))
    except UrsnavError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    report = Report("severity", {k: settings[k] for k in ("pictures", "steps")})
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    levels = np.linspace(0, 1, settings["steps"])
    poses, localizer = query_poses(vid, settings["pictures"]), Localizer(vid)
    for name in PRESETS:
        counts = [right_answers(vid, localizer, poses, name, float(s)) for s in levels]
        total = len(poses.calyx)
        for s, right in zip(levels, counts, strict=True):
            report.add(name, f"severity {s:.2f}, right calyx", "%", [100 * right / total], f"{right}/{total}", total)
        low, high = np.array([wilson(right, total) for right in counts]).T * 100
        axes.plot(levels, 100 * np.array(counts) / total, "o-", label=name.replace("_", " "))
        axes.fill_between(levels, low, high, alpha=0.2)
    axes.set(xlabel="severity: 0 clean, 1 every fault at its worst", ylabel="right calyx, %", ylim=(0, 102))
    axes.legend(loc="lower left")
    if settings["picture"]:
        figure.savefig(settings["picture"], dpi=110)
    report.finish(settings["out"])
    return 0


def query_poses(vid: Vid, count: int) -> Plan:
    """About ``count`` poses as a scope looks into calyces, 3 to 11 mm before their tips, at any roll."""
    each = max(1, round(count / len(vid.kidney.calyces)))
    plan = replace(
        PlanSettings(), views_per_calyx=each, passage_views=0, nearest_mm=3.0, farthest_mm=11.0, tilt_deg=8.0,
        roll_deg=180.0, seed=4321,
    )  # fmt: skip
    return plan_views(vid.kidney, vid.lumen, plan)


def right_answers(vid: Vid, localizer: Localizer, poses: Plan, preset: str, level: float) -> int:
    """How many pictures from the poses, at one severity of a preset, are given the right calyx."""
    renderer, right = RaycastRenderer(vid.kidney.mesh, vid.camera, light=HeadLight()), 0
    for i, (T, calyx) in enumerate(zip(poses.T_kidney_camera, poses.calyx, strict=True)):
        rng = np.random.default_rng(i)
        image = simulate(renderer, T, severity(preset, level, rng), rng)
        try:
            right += localizer.locate(image).calyx == calyx
        except FeatureError:
            continue
    return right
