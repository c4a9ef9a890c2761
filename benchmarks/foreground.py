"""Stones found in pictures whose foreground is known: ``python -m benchmarks.foreground data=DIR``.

Every folder ``KIDNEY/STYLE`` that holds ``foreground.csv`` beside ``truth.csv`` counts, and of its stones those that
cover at least ``least=0.01`` of the picture. Further arguments, each ``key=value``: ``out=FILE.json``,
``pictures=DIR`` (writes every picture with what was found: stones blue, instruments green, truth as a white circle).

Tried before and left, on 416 simulated pictures of three phantoms (317 right without): what is far bluer than the rest
of the picture taken for an instrument, too, finds a twentieth more of the instruments and leaves 315 right; bodies
filled in from their surroundings before the relief is taken, so that they have no rim, 313. The relief of the wall
beside bodies, which are no part of its surroundings, as tracks read it: in stills of two phantoms 172 of 221 right, and
two with too few edge points, instead of 173 (``python -m benchmarks.causes work=DIR phantoms=2``).
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.kidneys import Still, data_folder, stills
from benchmarks.shared.results import Report, errors_told, overrides
from benchmarks.shared.statistics import wilson
from ursnav_torch.camera import Camera, load_camera
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.files import write_image
from ursnav_torch.geometry import apply, inverse
from ursnav_torch.tables import read_csv

DEFAULTS = {"data": "", "least": 0.01, "out": "", "pictures": ""}
#: A stone found lies within its true radius of the true middle, or this far, px.
_NEAR_PX = 8.0


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its table and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("foreground", {"least": settings["least"]})
    if settings["pictures"]:
        Path(settings["pictures"]).mkdir(parents=True, exist_ok=True)
    folder = data_folder(settings["data"])
    for table in sorted(folder.glob("*/*/foreground.csv")):
        measure(report, folder, table, settings["least"], settings["pictures"])
    report.finish(settings["out"])
    return 0


def measure(report: Report, folder: Path, table: Path, least: float, pictures: str) -> None:
    """Rows for the pictures of one folder."""
    kidney, style = table.parent.parent.name, table.parent.name
    camera = load_camera(folder / kidney / "camera.json")
    extractor = DefaultExtractor(DefaultSettings(), camera)
    truth: dict[str, list[dict[str, str]]] = {}
    for row in read_csv(table, ("image", "what"), "foreground"):
        truth.setdefault(row["image"], []).append(row)
    large = seen = found = right = clean = quiet = 0
    for still in stills(folder, kidney, style):
        bodies = extractor.extract(still.image).bodies
        stones = [b for b in bodies if b.kind == "stone"]
        there = [s for r in truth.get(still.name, []) if r["what"] == "stone" and (s := disk(r, still, camera))]
        sizeable = [s for s in there if s[2] >= least]
        large += len(sizeable)
        seen += sum(any(meets(b, s) for b in stones) for s in sizeable)
        found += len(stones)
        right += sum(any(meets(b, s) for s in there) for b in stones)
        if not any(r["what"] == "stone" for r in truth.get(still.name, [])):
            clean, quiet = clean + 1, quiet + (not stones)
        if pictures:
            write_image(
                Path(pictures) / f"{kidney}_{style}_{Path(still.name).stem}.png", drawn(still.image, bodies, there)
            )
    name = f"{kidney}/{style}"
    for what, good, of in (
        (f"stones of {100 * least:g} % of the picture or more, found", seen, large),
        ("of what is found, stones", right, found),
        ("pictures without a stone, none found", quiet, clean),
    ):
        low, high = wilson(good, of) if of else (0.0, 1.0)
        note = f"{good}/{of}, 95 % interval {100 * low:.0f} to {100 * high:.0f} %"
        report.add(name, what, "%", [100 * good / max(of, 1)], note, of)


def disk(row: dict[str, str], still: Still, camera: Camera) -> tuple[NDArray[np.float64], float, float] | None:
    """Middle (2,) px, radius px and share of the picture of a true stone; None behind the camera."""
    center = apply(inverse(still.T_kidney_camera), np.array([[float(row[c]) for c in ("x_mm", "y_mm", "z_mm")]]))[0]
    distance, radius = float(np.linalg.norm(center)), float(row["r_mm"])
    side = np.cross(center, [0.0, 1.0, 0.0])
    rim = center + side / np.linalg.norm(side) * radius
    pixels, inside = camera.project(np.stack([center, rim]))
    if not inside[0] or distance <= radius:
        return None
    radius_px = float(np.linalg.norm(pixels[1] - pixels[0]))
    return pixels[0], radius_px, float(np.pi * radius_px**2 / camera.pixel_rays()[1].sum())


def meets(body: ForegroundBody, stone: tuple[NDArray[np.float64], float, float]) -> bool:
    """Whether what was found is this stone."""
    return float(np.linalg.norm(np.subtract(body.center_px, stone[0]))) <= max(stone[1], _NEAR_PX)


def drawn(
    image: NDArray[np.uint8],
    bodies: Sequence[ForegroundBody],
    there: Sequence[tuple[NDArray[np.float64], float, float]],
) -> NDArray[np.uint8]:
    """A picture with what was found and what is there."""
    shown = image.copy()
    for body in bodies:
        mask = cv2.resize(body.mask.astype(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(shown, contours, -1, (255, 80, 0) if body.kind == "stone" else (0, 255, 0), 1)
    for middle, radius, _ in there:
        cv2.circle(shown, tuple(np.rint(middle).astype(int).tolist()), round(radius), (255, 255, 255), 1)
    return shown


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
