"""How far murky water draws aligned poses ahead, with the water's glow found along with them and without.

    python -m benchmarks.murk                                # phantoms that chose nothing
    python -m benchmarks.murk half=choosing vary=water_mm=5,20

Pictures of every kind, as it is and in murk, from poses in the passages and calyces of ``phantoms`` kidneys, aligned
from ``far_mm`` and ``turned_deg`` off. Numbers are along the view, ahead of the true pose above 0, and in all. Other
arguments: ``pictures=40`` (a kidney and kind), ``out=FILE.json``. ``vary`` names a
setting of `RefinementSettings`, and values.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.refinement import pushed
from benchmarks.shared.flights import CHOOSING, JUDGING
from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.vary import named_values, with_value
from ursnav_torch.alignment import RefinementSettings, Refiner
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import Features
from ursnav_torch.geometry import inverse
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, SensorFaults, draw_faults, simulate
from ursnav_torch.vid import PlanSettings, Vid, plan_views

Array = NDArray[np.float64]
DEFAULTS = {
    "phantoms": 4, "half": JUDGING, "pictures": 40, "far_mm": 1.5, "turned_deg": 6.0, "vary": "", "out": "",
}  # fmt: skip
_FEW_VIEWS = PlanSettings(views_per_calyx=1, passage_views=1)  # starts are near the true pose: none is searched
#: Phantoms of the halves are this and following ones.
_FIRST = {CHOOSING: 300, JUDGING: 400}
_FAR_OFF_MM = 3.0


def main(arguments: Sequence[str]) -> int:
    """Align, print how far off, and keep the figures."""
    settings = overrides(DEFAULTS, arguments)
    if settings["half"] not in _FIRST:
        raise InputError(f"half={settings['half']!r} is no half of the phantoms; give {CHOOSING} or {JUDGING}.")
    if settings["vary"] and settings["half"] != CHOOSING:
        raise InputError(f"vary= chooses a setting, which the {JUDGING} half must not see; give half={CHOOSING}.")
    torch.set_num_threads(1)
    choices = {"as set": RefinementSettings(), "clear water": RefinementSettings(water_spread=0.0)}
    if settings["vary"]:
        name, values = named_values(settings["vary"])
        choices |= {f"{name}={value}": with_value(RefinementSettings(), name, value) for value in values}
    report = Report("murk", {k: v for k, v in settings.items() if k != "out"})
    off: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for seed in range(_FIRST[settings["half"]], _FIRST[settings["half"]] + settings["phantoms"]):
        with tempfile.TemporaryDirectory() as folder:
            vid = phantom_vid(make_phantom_kidney(seed), _FEW_VIEWS, Path(folder) / "vid")
            refiners = {name: Refiner(vid, choice) for name, choice in choices.items()}
            for kind, features, T, start in _pictures(vid, seed, settings):
                for name, refiner in refiners.items():
                    found = refiner.refine(features, [start]).T_kidney_camera
                    ahead = float((inverse(T) @ found)[2, 3])
                    off.setdefault((kind, name), []).append((ahead, float(np.linalg.norm((found - T)[:3, 3]))))
        print(f"phantom {seed}", file=sys.stderr, flush=True)
    for (kind, name), found_off in sorted(off.items()):
        ahead, away = np.array(found_off).T
        report.add(kind, f"{name}: ahead", "mm", ahead.tolist())
        report.add(kind, f"{name}: off", "mm", away.tolist(), f"90th percentile {np.percentile(away, 90):.2f}")
        report.add(kind, f"{name}: more than {_FAR_OFF_MM:g} mm off", "%", [100 * float((away > _FAR_OFF_MM).mean())])
    report.finish(settings["out"])
    return 0


def _pictures(vid: Vid, seed: int, settings: dict[str, Any]) -> Iterator[tuple[str, Features, Array, Array]]:
    """Kind, features, true pose and start (4, 4) of every picture that shows enough, clear and in murk."""
    rng, renderer, extractor = (
        np.random.default_rng(seed),
        RaycastRenderer(vid.kidney.mesh, vid.camera),
        vid.extractor(),
    )
    each = settings["pictures"]
    plan = PlanSettings(1 + each // (2 * len(vid.kidney.calyces)), passage_views=each // 2, seed=seed, roll_deg=180.0)
    for kind, preset in PRESETS.items():
        for T in rng.permutation(plan_views(vid.kidney, vid.lumen, plan).T_kidney_camera)[:each]:
            faults = draw_faults(preset, rng)
            start = pushed(T, vid.lumen, settings["far_mm"], settings["turned_deg"], rng)
            for name, drawn in ((kind, faults), (f"{kind}, in murk", _murky(faults, rng))):
                try:
                    yield name, extractor.extract(simulate(renderer, T, drawn, rng)), T, start
                except FeatureError:
                    continue


def _murky(faults: SensorFaults, rng: np.random.Generator) -> SensorFaults:
    """A scope's faults in murky water, as thick as a setting may be at most."""
    light, optics = faults.light, faults.optics
    murk, veil = rng.uniform(0.02, 0.12), rng.uniform(0.0, 0.6)
    return replace(
        faults,
        light=replace(light, turbidity_per_mm=max(light.turbidity_per_mm, murk)),
        optics=replace(optics, veil=max(optics.veil, veil)),
    )
