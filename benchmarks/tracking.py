"""Tracking over whole explorations: accuracy, losses, coverage, speed and memory.

    python -m benchmarks.tracking                          # simulated explorations of phantoms
    python -m benchmarks.tracking data=DIR                 # and the videos of the kidneys in DIR
    python -m benchmarks.tracking data=DIR work=DIR        # VIDs are kept there; benchmarks.accuracy shares them
    python -m benchmarks.tracking pictures=10000           # memory over so many pictures, too
    python -m benchmarks.tracking offline=false            # without the answers of hindsight
    python -m benchmarks.tracking live=false em=false      # with them alone, and without the sensor

A kidney's folder holds ``lumen.stl``, ``calyces.csv``, ``camera.json``, and for ``video``, ``partial`` and ``tissue``
(pictures of a path tracer) an ``.mp4``, ``_truth.csv`` and, where a sensor was carried, an ``_em.csv``. Every ``video``
is also tracked in the next kidney's VID, where it must end lost.
"""

import csv
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.kidneys import vid_of
from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, overrides, resident_mb
from ursnav_torch.errors import InputError
from ursnav_torch.evaluation import frames_to_loss, jitter_mm, pose_errors, success, trajectory_error_mm
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.geometry import look_along, transform_from_quaternion
from ursnav_torch.kidney import Kidney, make_phantom_kidney, observed_calyx
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, simulate
from ursnav_torch.runs.sources import open_source
from ursnav_torch.tracking.follow import Instruments, Moment, Source, follow_source
from ursnav_torch.tracking.offline import follow_both_ways
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import PlanSettings, Vid

SETTINGS = {
    "data": "", "work": "", "phantoms": 2, "views_per_calyx": 240, "live": True, "offline": True, "em": True,
    "pictures": 0, "out": "",
}  # fmt: skip
Array = NDArray[np.float64]
Follow = Callable[[Tracker, Source, Instruments], Iterator[tuple[Moment, Tracked]]]
Way = tuple[str, Follow]
#: What a setting asks for: how its rows are named, and who follows.
WAYS: dict[str, Way] = {"live": ("", follow_source), "offline": (", offline", follow_both_ways)}


@dataclass(frozen=True, slots=True)
class Exploration:
    """Pictures with their true poses (N, 4, 4) and calyces (N, blank for none); ``sensor`` (N) readings or None."""

    name: str
    moments: Callable[[], Iterator[Moment]]
    T_kidney_camera: Array
    calyx: list[str]
    sensor: list[SensorReading] | None = None


def main(arguments: list[str]) -> None:
    """Track everything, print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    ways = [way for name, way in WAYS.items() if settings[name]]
    if not ways:
        raise InputError("live=false and offline=false leave nothing to be judged; give one of them.")
    report = Report("tracking", {k: v for k, v in settings.items() if k not in ("data", "work", "out")})
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        cases = [_phantom(seed, settings, work) for seed in range(settings["phantoms"])]
        _judge_all(report, cases, ways, settings["em"])
        data = Path(settings["data"]) if settings["data"] else None
        if data is None:
            report.skip("videos", "data= names no folder of kidneys")
        else:
            names = sorted(p.parent.name for p in data.glob("*/video.mp4"))
            videos = [_kidney(data / name, work) for name in names]
            _judge_all(report, videos, ways, settings["em"])
            cases = videos + cases
        if settings["pictures"] and cases:
            _memory(report, *cases[0], settings["pictures"])
    report.finish(settings["out"])


def _judge_all(report: Report, cases: list[tuple[Vid, list[Exploration]]], ways: list[Way], em: bool) -> None:
    for vid, explorations in cases:
        for exploration in (e for e in explorations if em or e.sensor is None):
            for said, follow in ways:
                _judge(report, vid, exploration, exploration.name + said, follow)
    for (vid, _), (_, others) in zip(cases, cases[1:] + cases[:1], strict=True):
        if len(cases) > 1:
            _judge_other(report, vid, others[0], ways)


def _judge(report: Report, vid: Vid, exploration: Exploration, group: str, follow: Follow) -> None:
    """The bars: calyx, position, losses, coverage, speed."""
    T = exploration.T_kidney_camera
    tracker = Tracker(vid)
    coverage, truth = (Coverage(vid.kidney, vid.camera, tracker.lumen, vid.T_kidney_camera[::4]) for _ in range(2))
    answers: list[Tracked] = []
    readings = exploration.sensor
    source = Source(exploration.moments, len(T), exploration.name)
    start = time.perf_counter()
    beside = Instruments((lambda m: readings[m.frame]) if readings else None)
    for _, last in follow(tracker, source, beside):
        answers.append(last)
        if last.T_kidney_camera is not None and last.is_settled:
            coverage.look_through(tracker.shown)
            coverage.add(last.T_kidney_camera, 0.1, last.bodies, last.position_sd_mm)
    rate = len(answers) / (time.perf_counter() - start)
    for pose in T[: len(answers)]:
        truth.add(pose, 0.1)
    on = np.array([a.state == TRACKING for a in answers])
    nowhere = np.full((4, 4), np.nan)
    poses = np.array([a.T_kidney_camera if a.state == TRACKING else nowhere for a in answers])
    errors = pose_errors(poses, T[: len(on)])
    apart = errors.position_mm
    labeled = [i for i, name in enumerate(exploration.calyx[: len(on)]) if name]
    right = [vid.calyx_name(answers[i].calyx) == exploration.calyx[i] for i in labeled]
    report.add(group, "right calyx, of pictures that have one", "%", [100 * float(np.mean(right))], n=len(right))
    report.add(group, "position", "mm", apart[on].tolist())
    report.add(group, "position, 90th percentile", "mm", [float(np.percentile(apart[on], 90))], n=int(on.sum()))
    report.add(group, "direction", "deg", np.degrees(errors.direction[on]).tolist())
    report.add(group, "roll", "deg", np.degrees(errors.roll[on]).tolist())
    report.add(group, "needle, 10 mm ahead", "mm", errors.needle_mm[on].tolist())
    report.add(group, "absolute trajectory error", "mm", [trajectory_error_mm(errors)], n=int(on.sum()))
    report.add(group, "jitter", "mm", [jitter_mm(poses, T[: len(on)])], n=int(on.sum()))
    for within in (5.0, 10.0):
        report.add(group, f"known to {within:g} mm, of all pictures", "%", [100 * success(errors, within)], n=len(on))
    report.add(group, "pictures in a row before a loss", "pictures", [frames_to_loss(errors)], n=len(on))
    report.add(group, "not tracking", "%", [100 * float(1 - on.mean())], n=len(on))
    for far in (3, 5):
        share = 100 * float((apart[on] > far).mean())
        report.add(group, f"tracking, yet more than {far} mm off", "%", [share], n=int(on.sum()))
    region = np.array([np.nan if a.certainty is None else a.certainty.region_mm for a in answers])
    held = 100 * float((apart[on] <= region[on]).mean())
    report.add(group, "90 % region holds the truth", "%", [held], n=int(on.sum()))
    astray = [length / 10 for length in _runs(~(apart <= 5))]
    report.add(group, "longest time astray", "s", [max(astray, default=0.0)])
    if astray:
        report.add(group, "time to find back, or to find the first place", "s", astray)
    pairs = list(zip(coverage.calyces(), truth.calyces(), strict=True))
    same = sum(ours.verdict == theirs.verdict for ours, theirs in pairs)
    wrong = [f"{o.calyx} {o.verdict}, truly {t.verdict}" for o, t in pairs if o.verdict != t.verdict]
    report.add(group, "coverage verdicts right", "of " + str(len(pairs)), [float(same)], "; ".join(wrong), n=len(pairs))
    report.add(group, "pictures a second, coverage included", "1/s", [rate], n=len(answers))
    times = [1e3 * a.seconds for a in answers]
    report.add(group, "time a picture", "ms", times)
    report.add(group, "time a picture, 95th percentile", "ms", [float(np.percentile(times, 95))], n=len(times))


def _judge_other(report: Report, vid: Vid, exploration: Exploration, ways: list[Way]) -> None:
    """Pictures of another kidney: how much is believed, and how it ends."""
    source = Source(exploration.moments, len(exploration.T_kidney_camera), exploration.name)
    for said, follow in ways:
        states = [answer.state for _, answer in follow(Tracker(vid), source, Instruments())]
        group, share = f"{exploration.name} in another kidney's VID", 100 * states.count(TRACKING) / len(states)
        report.add(group, "tracking" + said, "%", [share], f"ends {states[-1]}", len(states))


def _memory(report: Report, vid: Vid, explorations: list[Exploration], pictures: int) -> None:
    """Resident memory while one exploration is tracked again and again."""
    tracker, used, count = Tracker(vid), list[float](), 0
    while count < pictures:
        for moment in explorations[0].moments():
            tracker.step(moment.image, count / 10)
            count += 1
            if count % max(pictures // 100, 1) == 0:
                used.append(resident_mb())
    third = max(len(used) // 3, 1)
    growth = float(np.median(used[-third:]) - np.median(used[third:-third]))
    report.add("memory", f"over {count} pictures", "MB", used)
    report.add("memory", "last third less the middle one", "MB", [growth])


def _kidney(folder: Path, work: Path) -> tuple[Vid, list[Exploration]]:
    """A kidney's VID and its videos, without and with EM."""
    vid = vid_of(folder.parent, folder.name, work)
    explorations = []
    for what in ("video", "partial", "tissue"):
        if not (folder / f"{what}.mp4").is_file():
            continue
        T, calyx = _truth(folder / f"{what}_truth.csv")
        source = open_source(folder / f"{what}.mp4")
        plain = Exploration(f"{folder.name} {what}", source.moments, T, calyx)
        explorations.append(plain)
        if (folder / f"{what}_em.csv").is_file() and (folder / f"{what}.json").is_file():
            sensor = _sensor(folder / f"{what}_em.csv", folder / f"{what}.json")
            explorations.append(replace(plain, name=plain.name + " with EM", sensor=sensor))
    return vid, explorations


def _truth(path: Path) -> tuple[Array, list[str]]:
    with path.open() as file:
        rows = list(csv.DictReader(file))
    place = np.array([[float(r[c]) for c in ("x_mm", "y_mm", "z_mm")] for r in rows])
    turn = np.array([[float(r[c]) for c in ("qx", "qy", "qz", "qw")] for r in rows])
    return transform_from_quaternion(place, turn), [r["calyx"] for r in rows]


def _sensor(em: Path, description: Path) -> list[SensorReading]:
    about = json.loads(description.read_text(encoding="utf-8"))
    R, t = np.array(about["kidney_from_em"]["R"]), np.array(about["kidney_from_em"]["t"])
    offset, sigma = np.array(about["sensor_offset_camera_mm"]), float(np.hypot(about["em_rms_mm"], 0.8) / np.sqrt(3))
    with em.open() as file:
        readings = [[float(r[c]) for c in ("x_mm", "y_mm", "z_mm")] for r in csv.DictReader(file)]
    return [SensorReading(R @ np.array(p) + t, offset, sigma) for p in readings]


def _phantom(seed: int, settings: dict[str, Any], work: Path) -> tuple[Vid, list[Exploration]]:
    """A phantom's VID, and a simulated flight in and out of its calyces, of half of them, blurred and dimmed."""
    plan = PlanSettings(settings["views_per_calyx"], settings["views_per_calyx"])
    vid = phantom_vid(make_phantom_kidney(seed, calyces=6), plan, work / f"phantom_{seed}")
    lumen, renderer = vid.lumen, RaycastRenderer(vid.kidney.mesh, vid.camera)
    preset = ("thesis_simulation", "thesis_phantom")[seed % 2]
    T = fly(vid.kidney, range(0, 6, 2), np.random.default_rng(seed))
    found = observed_calyx(T, vid.kidney, lumen)

    def moments() -> Iterator[Moment]:
        rng = np.random.default_rng(seed)
        faults = draw_faults(PRESETS[preset], rng)
        for i, pose in enumerate(T):
            image = simulate(renderer, pose, faults, rng)
            yield Moment(i, i / 10, np.full_like(image, 250) if i % 37 == 36 else image, str(i))

    name = f"phantom {seed}, half of it, as {preset}"
    return vid, [Exploration(name, moments, T, [vid.calyx_name(c) for c in found])]


def fly(kidney: Kidney, calyces: range, rng: np.random.Generator, step_mm: float = 0.6) -> Array:
    """Poses (N, 4, 4) of a flight along the centerline into calyces and back, looking ahead, with a hand's tremor."""
    poses, roll = [], 0.0
    for calyx in calyces:
        points = kidney.centerline.points_mm[kidney.centerline.path_to(calyx)]
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        stations = np.arange(0.0, along[-1] - 4.0, step_mm)
        for s in [*stations, *stations[::-1]]:
            at, ahead = (np.array([np.interp(s + d, along, points[:, i]) for i in range(3)]) for d in (0.0, 4.0))
            roll += float(rng.normal(0, 0.02))
            sway = rng.normal(0, 0.03, 3) * np.linalg.norm(ahead - at)
            poses.append(look_along(at + rng.normal(0, 0.05, 3), ahead - at + sway, roll))
    return np.array(poses)


def _runs(flags: NDArray[np.bool_]) -> list[int]:
    """Lengths of the runs of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [int(length) for length in edges[1::2] - edges[::2]]


if __name__ == "__main__":
    main(sys.argv[1:])
