"""Pictures that nobody drew: stills and video of a real endoscope, with poses from elsewhere.

    python -m benchmarks.real data=../shared/data/sinus
    python -m benchmarks.real data=DIR work=DIR             # keeps the VID

``data`` is a folder with ``lumen.stl``, ``calyces.csv``, ``camera.json``, ``poses.csv`` (where the VID's views are
drawn), ``frames/`` and ``truth.csv`` (``image`` and the seven pose columns, T_kidney_camera, in the order taken). Other
arguments: ``stride=4`` (every so many frames is a still) ``fps=10`` ``calibrate=true`` (ask simulated pictures of this
very lumen how far answers can be trusted) ``within_mm=2 within_deg=10`` ``out=FILE.json``. A blind guess is any of the
VID's views: what it reaches is printed first.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.results import Report, errors_told, overrides
from ursnav_torch.camera import load_camera
from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import DefaultSettings, read_image
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import load_mesh_kidney
from ursnav_torch.localization import Localizer, learn_confidence
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.tables import read_csv
from ursnav_torch.tracking.tracker import TRACKING, Tracker
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid, poses_from_rows, read_poses

DEFAULTS = {
    "data": "", "work": "", "stride": 4, "fps": 10.0, "calibrate": True, "within_mm": 2.0, "within_deg": 10.0,
    "out": "",
}  # fmt: skip
#: What `data` must hold.
FILES = ("lumen.stl", "calyces.csv", "camera.json", "poses.csv", "truth.csv", "frames")
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sequenced:
    """Real frames in the order taken, and their true poses (N, 4, 4)."""

    frames: list[Path]
    T_kidney_camera: Array


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("real", {k: v for k, v in settings.items() if k not in ("data", "work", "out")})
    folder = Path(settings["data"])
    missing = [name for name in FILES if not (folder / name).exists()]
    if not settings["data"] or missing:
        raise InputError(f"data={settings['data']} lacks {', '.join(missing)}; see the suite's docstring.")
    with tempfile.TemporaryDirectory() as scratch:
        vid = real_vid(folder, Path(settings["work"] or scratch), settings["calibrate"])
        taken = sequenced(folder)
        blind(report, vid, taken, settings)
        stills(report, vid, taken, settings)
        video(report, vid, taken, settings)
    report.finish(settings["out"])
    return 0


def real_vid(folder: Path, work: Path, calibrate: bool) -> Vid:
    """The VID at the places of ``poses.csv``, built in ``work`` once and then kept there."""
    out = work / f"{folder.resolve().name}_{'calibrated' if calibrate else 'poses'}"
    if (out / "vid.json").exists():
        return load_vid(out)
    make_renderer = partial(RaycastRenderer, light=HeadLight())
    return build_vid(
        load_mesh_kidney(folder / "lumen.stl", calyces=folder / "calyces.csv"),
        load_camera(folder / "camera.json"),
        DefaultSettings(),
        make_renderer,
        read_poses(folder / "poses.csv"),
        out,
        workers=1,
        learn=partial(learn_confidence, make_renderer=make_renderer, plan=PlanSettings()) if calibrate else None,
    )


def sequenced(folder: Path) -> Sequenced:
    """The frames that ``truth.csv`` names, in its order.

    Raises:
        InputError: a row is no pose, or names no frame.
    """
    rows = read_csv(folder / "truth.csv", ("image", *POSE_COLUMNS), "truth")
    frames = [folder / "frames" / row["image"] for row in rows]
    absent = [path.name for path in frames if not path.is_file()]
    if absent:
        raise InputError(f"{folder / 'truth.csv'} names {absent[0]} and others that are not in {folder / 'frames'}.")
    return Sequenced(frames, poses_from_rows(rows))


def blind(report: Report, vid: Vid, taken: Sequenced, settings: dict[str, Any]) -> None:
    """Any view of the VID as the answer: the share of pairs of view and frame that are near each other."""
    T, true = vid.T_kidney_camera, taken.T_kidney_camera[:: settings["stride"]]
    mm = np.linalg.norm(T[None, :, :3, 3] - true[:, None, :3, 3], axis=-1)
    deg = np.degrees(np.arccos(np.clip(np.einsum("vi,ni->nv", T[:, :3, 2], true[:, :3, 2]), -1, 1)))
    _report(report, "blind guess", mm.ravel(), deg.ravel(), settings)


def stills(report: Report, vid: Vid, taken: Sequenced, settings: dict[str, Any]) -> None:
    """Every so many frames located by itself."""
    localizer, mm, deg, accepted, within_sd = Localizer(vid), [], [], [], []
    for path, T in list(zip(taken.frames, taken.T_kidney_camera, strict=True))[:: settings["stride"]]:
        try:
            found = localizer.locate(read_image(path))
        except FeatureError:
            errors, sure, sd = (np.inf, 180.0), False, 0.0
        else:
            errors, sure, sd = off(found.T_kidney_camera, T), found.accepted, found.position_sd_mm
        mm.append(errors[0])
        deg.append(errors[1])
        accepted.append(sure)
        within_sd.append(errors[0] <= sd)
    _report(report, "stills", np.array(mm), np.array(deg), settings)
    report.add("stills", "accepted", "%", [100 * float(np.mean(accepted))], n=len(mm))
    report.add("stills", "position within one sd", "%", [100 * float(np.mean(within_sd))], n=len(mm))


def video(report: Report, vid: Vid, taken: Sequenced, settings: dict[str, Any]) -> None:
    """All frames followed as a video; a frame without a pose is within nothing."""
    tracker, mm, deg, believed = Tracker(vid), [], [], []
    for i, (path, T) in enumerate(zip(taken.frames, taken.T_kidney_camera, strict=True)):
        found = tracker.step(read_image(path), i / settings["fps"])
        believed.append(found.state == TRACKING)
        pose = found.T_kidney_camera
        errors = (np.inf, 180.0) if pose is None else off(pose, T)
        mm.append(errors[0])
        deg.append(errors[1])
    report.add("track", "poses believed", "%", [100 * float(np.mean(believed))], n=len(mm))
    _report(report, "track", np.array(mm), np.array(deg), settings)


def off(T: Array, T_true: Array) -> tuple[float, float]:
    """How far a pose (4, 4) is from the true one: mm, and degrees between the viewing directions."""
    turned = np.degrees(angle_between(T[:3, 2], T_true[:3, 2]))
    return float(np.linalg.norm(T[:3, 3] - T_true[:3, 3])), float(turned)


def _report(report: Report, group: str, mm: Array, deg: Array, settings: dict[str, Any]) -> None:
    near = (mm <= settings["within_mm"]) & (deg <= settings["within_deg"])
    name = f"within {settings['within_mm']:g} mm and {settings['within_deg']:g}°"
    report.add(group, name, "%", [100 * float(near.mean())], f"{near.sum()}/{len(near)}", len(near))
    known = np.isfinite(mm)
    if known.any():
        report.add(group, "position", "mm", mm[known].tolist())
        report.add(group, "direction", "°", deg[known].tolist())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
