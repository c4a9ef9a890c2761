"""How much of the relief the wall network should say: ``python -m benchmarks.wall_network.share work=DIR``.

Pictures of phantoms that the network never saw, of four kinds (`WIDE`, the same through a good sensor, in vivo like,
printed phantom), three of the kinds in a kidney that has moved and swollen, are located with each share and with the
foreground left in; what is right is counted. Arguments, each ``key=value``: ``work=DIR`` (keeps the VIDs),
``phantoms=2`` ``views=120`` (a calyx) ``pictures=3`` (a calyx and kind) ``out=FILE.json``.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.results import Report, overrides
from benchmarks.wall_network.pictures import good_sensor
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import HeadLight, RaycastRenderer, WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor import draw_faults, simulate
from ursnav_torch.rendering.sensor.presets import IN_VIVO_LIKE, THESIS_PHANTOM, WIDE
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid, plan_views

DEFAULTS = {"work": "", "phantoms": 2, "views": 120, "pictures": 3, "out": ""}
FIRST_SEED = 1100
SHARES = (0.0, 0.3, 0.5, 1.0)
KINDS = {"wide": WIDE, "wide, good sensor": WIDE, "in vivo like": IN_VIVO_LIKE, "printed phantom": THESIS_PHANTOM}
MAKE_RENDERER = partial(RaycastRenderer, light=HeadLight())


def main(arguments: Sequence[str]) -> int:
    """Run the choice, print its table and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    if not settings["work"]:
        raise InputError("work= must name a folder for the phantoms' VIDs.")
    report = Report("wall_network_share", {k: v for k, v in settings.items() if k not in ("work", "out")})
    right: dict[tuple[str, float], list[bool]] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + settings["phantoms"]):
        vid = vid_of(seed, settings["views"], Path(settings["work"]))
        asked = {share: Localizer(replace(vid, settings=DefaultSettings(learned=share))) for share in SHARES}
        for kind, image, calyx in pictures(vid, settings["pictures"], seed):
            for share, localizer in asked.items():
                right.setdefault((kind, share), []).append(_right(localizer, image, calyx))
        print(f"phantom {seed} done", file=sys.stderr, flush=True)
    for (kind, share), own in sorted(right.items()):
        note = f"{sum(own)}/{len(own)}"
        report.add(f"right calyx, {kind}", f"learned={share}", "%", [100 * float(np.mean(own))], note, len(own))
    for share in SHARES:
        own = [r for (_, s), some in right.items() if s == share for r in some]
        note = f"{sum(own)}/{len(own)}"
        report.add("right calyx, all kinds", f"learned={share}", "%", [100 * float(np.mean(own))], note, len(own))
    print(report.table())
    print(f"\nwritten to {report.write(Path(settings['out']) if settings['out'] else None)}")
    return 0


def vid_of(seed: int, views: int, work: Path) -> Vid:
    """A phantom's VID, built once."""
    out = work / f"share_{seed}_{views}"
    if (out / "vid.json").exists():
        return load_vid(out)
    work.mkdir(parents=True, exist_ok=True)
    plan = PlanSettings(views_per_calyx=views)
    return build_vid(make_phantom_kidney(seed), equidistant_camera(), DefaultSettings(), MAKE_RENDERER, plan, out)


def pictures(vid: Vid, count: int, seed: int) -> Iterator[tuple[str, NDArray[np.uint8], int]]:
    """Kind, picture and calyx, from 3 to 11 mm before the calyces' tips, at any roll."""
    rng = np.random.default_rng(seed)
    plan = PlanSettings(
        views_per_calyx=count, passage_views=0, nearest_mm=3, farthest_mm=11, tilt_deg=8, roll_deg=180, seed=77
    )
    views = plan_views(vid.kidney, vid.lumen, plan)
    for kind, preset in KINDS.items():
        moved = deform_mesh(vid.kidney.mesh, WarpSettings(amplitude_mm=1.2, distension=0.05), rng)
        still = kind == "printed phantom"
        renderer = MAKE_RENDERER(vid.kidney.mesh if still else moved.mesh, vid.camera)
        for T, calyx in zip(views.T_kidney_camera, views.calyx, strict=True):
            faults = draw_faults(preset, rng)
            if kind == "wide, good sensor":
                faults = good_sensor(faults, rng)
            yield kind, simulate(renderer, T if still else moved.carry(T), faults, rng), int(calyx)


def _right(localizer: Localizer, image: NDArray[np.uint8], calyx: int) -> bool:
    try:
        return localizer.locate(image).calyx == calyx
    except FeatureError:
        return False


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
