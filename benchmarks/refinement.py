"""Refined poses against the nearest view's and PnP's, and from how far off they are found.

``python -m benchmarks.refinement``; arguments, each ``key=value``: ``vid=DIR`` (a phantom's is built when left out),
``data=DIR`` (folders of pictures with a truth.csv each; left out when blank), ``pictures=30`` (simulated, a kind),
``starts=20`` (a cell of the basin's table), ``threads=1``, ``out=FILE.json``. With ``pictures=0`` the basin alone.
"""

import csv
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, overrides
from ursnav_torch.alignment import EdgePnp, RefinementSettings, Refiner
from ursnav_torch.errors import FeatureError
from ursnav_torch.evaluation import pose_errors
from ursnav_torch.features import Features, read_image
from ursnav_torch.geometry import angle_between, transform_from, transform_from_quaternion
from ursnav_torch.kidney import LumenDistance, make_phantom_kidney
from ursnav_torch.localization import LocalizationSettings, Localizer, Location
from ursnav_torch.localization.locate import MM_PER_DEG
from ursnav_torch.rendering import RaycastRenderer, WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, simulate
from ursnav_torch.vid import PlanSettings, Vid, load_vid, plan_views

Array = NDArray[np.float64]
Picture = tuple[NDArray[np.uint8], Array]  # with its T_kidney_camera
Way = Callable[[Location], Array]

DEFAULTS = {"vid": "", "data": "", "pictures": 30, "starts": 20, "threads": 1, "out": ""}
#: Errors of the basin's starts, in all combinations.
BASIN_MM, BASIN_DEG = (1.0, 2.0, 5.0, 10.0), (10.0, 20.0, 30.0)
#: A start is found when the pose ends this near.
FOUND_MM, FOUND_DEG = 1.0, 5.0


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    torch.set_num_threads(settings["threads"])
    with tempfile.TemporaryDirectory() as folder:
        vid = load_vid(settings["vid"]) if settings["vid"] else _phantom_vid(Path(folder))
        report = Report("refinement", {k: v for k, v in settings.items() if k != "out"})
        lumen = vid.lumen
        localizer, ways = Localizer(vid, settings=LocalizationSettings(refine=False)), _ways(vid, lumen)
        for name in PRESETS if settings["pictures"] else ():
            compare(report, f"simulated pictures, {name}", localizer, ways, _simulated(vid, name, settings["pictures"]))
        folders = sorted(Path(settings["data"]).glob("*/truth.csv")) if settings["data"] else []
        if not folders:
            report.skip("given pictures", "data= names no folder of folders with a truth.csv")
        for truth in folders:
            compare(report, f"given pictures, {truth.parent.name}", localizer, ways, _given(truth))
        basin(report, vid, lumen, settings["starts"])
    report.finish(settings["out"])
    return 0


def compare(
    report: Report, group: str, localizer: Localizer, ways: dict[str, Way], pictures: Iterable[Picture]
) -> None:
    """Errors of every way on the accepted pictures, and its CPU time."""
    true: list[Array] = []
    found: dict[str, list[Array]] = {name: [] for name in ways}
    spent: dict[str, list[float]] = {name: [] for name in ways}
    for image, T in pictures:
        try:
            location = localizer.locate(image)
        except FeatureError:
            continue
        if not location.accepted:
            continue
        true.append(T)
        for name, way in ways.items():
            start = time.process_time()
            found[name].append(way(location))
            spent[name].append(1e3 * (time.process_time() - start))
    if not true:
        report.skip(group, "no picture was accepted")
        return
    for name in ways:
        errors = pose_errors(np.array(found[name]), np.array(true))
        report.add(group, f"{name}: position", "mm", errors.position_mm.tolist())
        report.add(group, f"{name}: direction", "deg", np.degrees(errors.direction).tolist())
        report.add(group, f"{name}: roll", "deg", np.degrees(errors.roll).tolist())
        report.add(group, f"{name}: time", "ms", spent[name], "CPU time, a picture")


def basin(report: Report, vid: Vid, lumen: LumenDistance, starts: int) -> None:
    """Share of starts, off by so much, from which a pose ends within `FOUND_MM` and `FOUND_DEG`.

    "one start": the pose that is off; "with PnP": beside it the pose that the edges of the nearest view give there, the
    better of the two kept as the refiner keeps it. "PnP nearer": how often that pose is nearer the truth to begin with.
    """
    refiner, rng = Refiner(vid, RefinementSettings(hypotheses=2, at_first=2)), np.random.default_rng(2)
    pictures = list(_simulated(vid, "thesis_simulation", starts, warp_mm=0.0))
    extractor, pnp = vid.extractor(), EdgePnp(vid)
    seen: list[tuple[Features, Array]] = [(extractor.extract(image), T) for image, T in pictures]
    for far in BASIN_MM:
        for turned in BASIN_DEG:
            alone, both, nearer = [], [], []
            for features, T in seen:
                start = pushed(T, lumen, far, turned, rng)
                solved = pnp.pose(features.edges, _nearest_view(vid, start), start)
                alone.append(_is_found(refiner.refine(features, [start]).T_kidney_camera, T))
                both.append(alone[-1])
                if solved is not None:
                    nearer.append(_off_mm(solved.T_kidney_camera, T) < _off_mm(start, T))
                    beside = [start, solved.T_kidney_camera]
                    both[-1] = _is_found(refiner.refine(features, beside).T_kidney_camera, T)
            cell, note = f"{far:g} mm, {turned:g} deg off", f"ends within {FOUND_MM:g} mm and {FOUND_DEG:g} deg"
            report.add("basin, one start", cell, "%", [100 * float(np.mean(alone))], note, n=len(alone))
            report.add("basin, with PnP", cell, "%", [100 * float(np.mean(both))], note, n=len(both))
            note = f"{sum(nearer)} of {len(nearer)} poses that PnP gave, of {len(seen)} asked for"
            report.add("PnP nearer than its start", cell, "%", [100 * sum(nearer) / max(len(nearer), 1)], note,
                       n=len(nearer))  # fmt: skip


def _is_found(T: Array, T_true: Array) -> bool:
    """Whether a pose (4, 4) is within `FOUND_MM` and `FOUND_DEG` of the true one."""
    errors = pose_errors(T[None], T_true[None])
    return bool((errors.position_mm[0] < FOUND_MM) & (np.degrees(errors.direction[0]) < FOUND_DEG))


def _off_mm(T: Array, T_true: Array) -> float:
    return float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))


def _nearest_view(vid: Vid, T: Array) -> int:
    """The view nearest to a pose (4, 4), a degree counting as `MM_PER_DEG`; a roll costs nothing, a search finds it."""
    away = np.linalg.norm(vid.T_kidney_camera[:, :3, 3] - T[:3, 3], axis=1)
    turned = np.degrees(angle_between(vid.T_kidney_camera[:, :3, 2], T[:3, 2]))
    return int((away + MM_PER_DEG * turned).argmin())


def _ways(vid: Vid, lumen: LumenDistance) -> dict[str, Way]:
    """From a location to a pose, by name."""
    one, several = (Refiner(vid, RefinementSettings(hypotheses=n)) for n in (1, 3))
    pnp = EdgePnp(vid)

    def by_pnp(location: Location) -> Array:
        best = location.candidates[0]
        solved = pnp.pose(location.features.edges, best.view, best.T_kidney_camera)
        return best.T_kidney_camera if solved is None else solved.T_kidney_camera

    return {
        "nearest view": lambda location: location.T_kidney_camera,
        "PnP": by_pnp,
        "aligned, 1 hypothesis": lambda x: one.refine(x.features, [x.T_kidney_camera]).T_kidney_camera,
        "aligned, 3 hypotheses": lambda x: (
            several.refine(x.features, [c.T_kidney_camera for c in x.candidates]).T_kidney_camera
        ),
        "PnP, then aligned": lambda x: one.refine(x.features, [by_pnp(x)]).T_kidney_camera,
        "aligned, nearest view and PnP": lambda x: (
            several.refine(x.features, [x.T_kidney_camera, by_pnp(x)]).T_kidney_camera
        ),
    }


def _phantom_vid(folder: Path) -> Vid:
    """A small VID of a phantom kidney."""
    plan = PlanSettings(views_per_calyx=120, passage_views=120)
    return phantom_vid(make_phantom_kidney(7, calyces=6), plan, folder / "vid")


def _simulated(vid: Vid, preset: str, count: int, warp_mm: float = 1.0) -> Iterator[Picture]:
    """Pictures of the kidney, warped by ``warp_mm``, from poses that are no views; a stranger's light and sensor."""
    rng = np.random.default_rng(list(PRESETS).index(preset))
    lumen = vid.lumen
    plan = PlanSettings(views_per_calyx=1 + count // len(vid.kidney.calyces), passage_views=0, seed=99, roll_deg=180.0)
    warp = deform_mesh(vid.kidney.mesh, WarpSettings(amplitude_mm=warp_mm), rng)
    renderer = RaycastRenderer(warp.mesh, vid.camera)
    for T in islice(rng.permutation(plan_views(vid.kidney, lumen, plan).T_kidney_camera), count):
        yield simulate(renderer, warp.carry(T), draw_faults(PRESETS[preset], rng), rng), T


def _given(truth: Path) -> Iterator[Picture]:
    """The pictures that a truth.csv names, beside it."""
    with truth.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            t, q = ([float(row[c]) for c in names] for names in (("x_mm", "y_mm", "z_mm"), ("qx", "qy", "qz", "qw")))
            yield read_image(truth.parent / row["image"]), transform_from_quaternion(t, q)


def pushed(T: Array, lumen: LumenDistance, far_mm: float, turned_deg: float, rng: np.random.Generator) -> Array:
    """A pose inside the lumen about ``far_mm`` away, turned by ``turned_deg`` about a random axis."""
    away = np.linalg.norm(lumen.grid.centers_mm - T[:3, 3], axis=1)
    room = lumen.grid.radius_mm > 1.0
    off = np.where(room, np.abs(away - far_mm), np.inf)
    position = lumen.grid.centers_mm[rng.choice(np.argsort(off)[:40])]
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(np.radians(turned_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return transform_from(T[:3, :3] @ turn, position)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
