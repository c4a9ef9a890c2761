"""How far off the middle may a principal point be? Thresholds of `camera.sense`, chosen on one half, judged on another.

    python -m benchmarks.endocal.lens_sense [lenses=4000]

Lenses that are right are off by how they are mounted and by how their pictures were cut. The first was fitted to
published calibrations (`MEASURED`: endocal's two endoscopes; EuRoC, TUM RGB-D and others as their files give them): a
normal law on either axis. The second: of a frame as grabbers give it a part was cut that holds most of the scope's
circle. Wrong ones are the same lenses stated with another frame's size, or with row and column exchanged. What is said
begins where the share of the wrong lenses that are said is farthest above that of the right ones, half of them cut
(Youden's index); what is refused where no right lens is any more.
"""

import sys
from typing import Any

import numpy as np

from benchmarks.shared.results import Report, overrides
from ursnav_torch.camera import sense
from ursnav_torch.geometry import Array

#: Published calibrations: width, height, cx, cy in px.
MEASURED = np.array([
    (768, 710, 420.1, 361.5), (1920, 1080, 995.8, 547.8), (752, 480, 367.2, 248.4), (640, 480, 318.6, 255.3),
    (640, 480, 311.8, 247.5), (640, 480, 322.4, 232.5), (1920, 1080, 905.0, 529.1), (1440, 1440, 654.7, 757.5),
    (1280, 720, 641.9, 326.5), (752, 480, 356.4, 231.2), (816, 960, 396.5, 463.4), (2880, 1860, 1424.5, 943.5),
])  # fmt: skip
#: Frames as grabbers and cameras give them, px.
FRAMES = np.array([(640, 480), (720, 576), (768, 576), (800, 600), (1280, 720), (1280, 1024), (1920, 1080), (400, 400)])
#: A cut keeps so much of the circle's width and height, at least.
KEPT = 0.7
SETTINGS: dict[str, Any] = {"lenses": 4000, "out": ""}


def mounted_sd() -> float:
    """Standard deviation on either axis of how far off the middle published lenses are, of the picture's side."""
    return float(np.sqrt(np.mean(off_middle(MEASURED[:, :2], MEASURED[:, 2:]) ** 2)))


def off_middle(size: Array, center: Array) -> Array:
    """(N, 2) how far principal points (N, 2) are off the middle of pictures of a size (N, 2) in px, of the side."""
    return np.asarray((center - (size - 1) / 2) / size)


def right_lenses(rng: np.random.Generator, count: int, cut: bool) -> tuple[Array, Array]:
    """Sizes (N, 2) and principal points (N, 2) of lenses that are right, in px."""
    size = FRAMES[rng.integers(0, len(FRAMES), count)].astype(float)
    center = (size - 1) / 2 + rng.normal(0, mounted_sd(), (count, 2)) * size
    if not cut:
        return size, center
    radius = rng.uniform(0.3, 0.5, (count, 1)) * size.min(axis=1, keepdims=True)
    first = np.maximum(center - radius, 0) + rng.uniform(-0.5, 1 - KEPT, (count, 2)) * 2 * radius
    last = np.minimum(center + radius, size) - rng.uniform(-0.5, 1 - KEPT, (count, 2)) * 2 * radius
    first, last = np.clip(np.round(first), 0, None), np.minimum(np.round(last), size)
    whole = (last - first >= KEPT * 2 * radius - 1).all(axis=1)  # not cut from both sides beyond what is kept
    return (last - first)[whole], (center - first)[whole]


def wrong_lenses(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """The same for lenses that are stated with another frame's size, or with row and column exchanged."""
    size, center = right_lenses(rng, count, cut=False)
    other = FRAMES[rng.integers(0, len(FRAMES), count)].astype(float)
    exchanged = rng.random(count) < 0.3
    stated = np.where(exchanged[:, None], size, other)
    center = np.where(exchanged[:, None], center[:, ::-1], center)
    told = (stated != size).any(axis=1) | (exchanged & (size[:, 0] != size[:, 1]))
    return stated[told], center[told]


def farthest(lenses: tuple[Array, Array]) -> Array:
    """(N,) the larger of both axes' distance off the middle, as `camera.sense` takes it."""
    return np.abs(off_middle(*lenses)).max(axis=1)


def main(arguments: list[str]) -> None:
    """Choose on seed 0, judge today's constants on seed 1; print and keep both."""
    settings = overrides(SETTINGS, arguments)
    report = Report("lens_sense", settings)
    report.add("published lenses", "standard deviation off the middle", "%", [100 * mounted_sd()], n=len(MEASURED))
    count = int(settings["lenses"])
    for seed, half in enumerate(("choosing", "judging")):
        rng = np.random.default_rng(seed)
        whole, cut = farthest(right_lenses(rng, count, False)), farthest(right_lenses(rng, count, True))
        wrong = farthest(wrong_lenses(rng, count))
        if half == "choosing":
            tried = np.arange(0.02, 0.4, 0.005)
            gain = [(wrong > t).mean() - ((whole > t).mean() + (cut > t).mean()) / 2 for t in tried]
            report.add(half, "say from", "%", [100 * float(tried[int(np.argmax(gain))])], n=len(whole) + len(cut))
            report.add(half, "refuse from", "%", [100 * float(cut.max())], n=len(cut))
            continue
        for name, off in (("right, whole", whole), ("right, cut", cut), ("of another frame", wrong)):
            report.add(f"{half}: {name}", "said", "%", [100 * float((off > sense.FAR_OFF).mean())], n=len(off))
            report.add(f"{half}: {name}", "refused", "%", [100 * float((off > sense.AT_THE_RIM).mean())], n=len(off))
    report.finish(settings["out"])


if __name__ == "__main__":
    main(sys.argv[1:])
