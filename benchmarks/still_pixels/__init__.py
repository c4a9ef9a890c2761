"""Whether a mask or text burnt into a video is told from a slow scope: ``python -m benchmarks.still_pixels``.

Flights through phantoms, of every kind of picture, are looked at as they are, with a caption, and with a narrower
mask, after several counts of pictures: how often something is found, and the doubtful pixels for one that never
changes, on which `features.static` decides. Arguments, each ``key=value``: ``phantoms=4`` ``out=FILE.json``.
"""

import sys
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.results import Report, overrides
from benchmarks.tracking import fly
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import StillPixels
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization.learn import LEARNED_FROM
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import draw_faults, simulate

Image = NDArray[np.uint8]
DEFAULTS = {"phantoms": 4, "out": ""}
FIRST_SEED, LENS_PX, STEP_MM = 31, 250, 0.6
LOOKED_AT = (24, 48, 96, 192)


def captioned(image: Image) -> Image:
    """A picture with a patient's name."""
    return np.asarray(cv2.putText(image.copy(), "PATIENT 17", (45, 205), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255,) * 3, 5))


def narrowed(image: Image) -> Image:
    """A picture behind a mask that cuts off a fifth of it."""
    shown = image.copy()
    shown[:, :50] = 3
    return shown


KINDS: dict[str, Callable[[Image], Image]] = {"as it is": lambda image: image, "caption": captioned, "mask": narrowed}


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its table and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("still_pixels", {"phantoms": settings["phantoms"]})
    found: dict[tuple[str, int], list[bool]] = {}
    doubtful: dict[tuple[str, int], list[float]] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + settings["phantoms"]):
        for pictures in flights(seed):
            look(pictures, found, doubtful)
        print(f"phantom {seed} done", file=sys.stderr, flush=True)
    for (kind, count), own in found.items():
        name = f"after {count} pictures"
        report.add(
            f"something is found, {kind}", name, "%", [100 * float(np.mean(own))], f"{sum(own)}/{len(own)}", len(own)
        )
        finite = [d for d in doubtful[kind, count] if np.isfinite(d)]
        if finite:
            report.add(f"doubtful pixels for a still one, {kind}", name, "of 1", finite)
    report.finish(settings["out"])
    return 0


def flights(seed: int) -> list[list[Image]]:
    """Pictures of one flight through a phantom, once with the faults of each kind."""
    kidney, lens = make_phantom_kidney(seed, calyces=7), equidistant_camera(160.0, LENS_PX, LENS_PX)
    renderer, rng = RaycastRenderer(kidney.mesh, lens), np.random.default_rng(seed)
    poses = fly(kidney, range(0, 7, 2), rng, STEP_MM)[: LOOKED_AT[-1]]
    faults = [draw_faults(preset, rng) for preset in LEARNED_FROM.values()]
    return [[simulate(renderer, T, own, rng) for T in poses] for own in faults]


def look(
    pictures: Sequence[Image], found: dict[tuple[str, int], list[bool]], doubtful: dict[tuple[str, int], list[float]]
) -> None:
    """Add what is found in one flight, and the doubtful pixels for a still one; nan where there is no still one."""
    inside = equidistant_camera(160.0, LENS_PX, LENS_PX).pixel_rays()[1]
    for kind, change in KINDS.items():
        seen = StillPixels(inside)
        for image in pictures:
            seen.add(change(image))
            if seen.count in LOOKED_AT:
                found.setdefault((kind, seen.count), []).append(seen.scene() is not None)
                still, between = seen.counts()
                doubtful.setdefault((kind, seen.count), []).append(between / still if still else float("nan"))
