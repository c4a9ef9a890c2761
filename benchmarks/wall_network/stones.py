"""How sure a stone must be to be told: ``python -m benchmarks.wall_network.stones work=DIR``.

On phantoms kept back from the network's lessons, for each least probability of a region: how many of the stones that
cover a hundredth of the picture or more are found, how much of what is found is stone, and in how many pictures
without one nothing is found. Arguments, each ``key=value``: ``work=DIR`` (the lessons, drawn where they are not there),
``phantoms=2`` ``out=FILE.json``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.measure import label, regionprops

from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.wall_network.pictures import Lesson, lesson
from ursnav_torch.features.foreground import ForegroundBody, find_bodies
from ursnav_torch.features.network import WallReader, lens_rays
from ursnav_torch.rendering.sensor.bodies import STONE

DEFAULTS = {"work": "", "phantoms": 2, "out": ""}
FIRST_SEED = 8002
SURE = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95)
#: Share of the picture from which on a stone must be found, and share of a region that must be stone.
LARGE, MOSTLY = 0.01, 0.5


@dataclass(slots=True)
class Count:
    """What was counted at one probability."""

    large: int = 0
    seen: int = 0
    found: int = 0
    right: int = 0
    without: int = 0
    quiet: int = 0

    def add(self, stones: NDArray[np.bool_], found: Sequence[ForegroundBody], area: float) -> None:
        """Take in a picture's true stones (H, W) and what was found."""
        regions = [r for r in regionprops(label(stones)) if r.area >= LARGE * area]
        self.large += len(regions)
        self.seen += sum(any(b.mask[tuple(r.coords.T)].mean() >= MOSTLY / 2 for b in found) for r in regions)
        self.found += len(found)
        self.right += sum(stones[b.mask].mean() >= MOSTLY for b in found)
        self.without += not stones.any()
        self.quiet += not stones.any() and not found


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Count, print the table and write the JSON file."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the lessons")
    torch.set_num_threads(1)
    counts = {sure: Count() for sure in SURE}
    for seed in range(FIRST_SEED, FIRST_SEED + settings["phantoms"]):
        taught = lesson(seed, work)
        if taught is not None:
            _look(taught, counts)
    report = Report("wall_network_stones", {"phantoms": settings["phantoms"]})
    for sure, c in counts.items():
        for what, good, of in (
            ("found", c.seen, c.large),
            ("are stones", c.right, c.found),
            ("quiet", c.quiet, c.without),
        ):
            report.add(f"stones, {what}", f"sure={sure}", "%", [100 * good / max(of, 1)], f"{good}/{of}", max(of, 1))
    report.finish(settings["out"])
    return 0


@torch.inference_mode()
def _look(taught: Lesson, counts: dict[float, Count]) -> None:
    for row, picture in enumerate(taught.picture):
        camera = taught.camera(row)
        mask = lens_rays(camera)[2]
        _, probability = WallReader(camera, mask).read(picture)
        for sure, count in counts.items():
            found = [b for b in find_bodies(probability, mask, 1.0, sure) if b.kind == "stone"]
            count.add(taught.kind[row] == STONE, found, float(mask.sum()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
