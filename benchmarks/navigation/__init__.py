"""Live navigation: how long from a picture to its pose, how many poses a second, and does anything drift?

    python -m benchmarks.navigation                    # a recorded flight of 60 s through the phantom
    python -m benchmarks.navigation minutes=30         # half an hour: memory, and frame time against pose time
    python -m benchmarks.navigation vid=my_vid record=my_session

A flight through the phantom is drawn and recorded; its pictures are then fed at the camera's rate, forth and back, to
`Navigator`, without a browser. Latency counts from the moment a picture is handed over until its pose is on the bus.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.shared.results import Report, overrides, resident_mb
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.navigation import Navigator
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import severity, simulate
from ursnav_torch.session import Recorder, Replay
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid

SETTINGS = {
    "minutes": 1.0,
    "rate_hz": 15.0,
    "views_per_calyx": 240,
    "lens_px": 250,
    "sensor": "thesis_simulation",
    "flight_s": 60.0,
    "vid": "",
    "record": "",
    "out": "",
}


def main(arguments: list[str]) -> None:
    """Measure, print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    torch.set_num_threads(1)
    report = Report("navigation", settings)
    with tempfile.TemporaryDirectory() as folder:
        navigator, frames = prepare(settings, Path(folder))
        _measure(report, navigator, frames, settings)
    report.finish(settings["out"])


def prepare(settings: dict[str, Any], folder: Path) -> tuple[Navigator, list[Frame]]:
    """A navigator and a recorded flight's pictures; what the settings do not name is made in a folder."""
    vid = load_vid(settings["vid"]) if settings["vid"] else phantom_vid(settings, folder / "vid")
    record = Path(settings["record"] or folder / "record")
    if not settings["record"]:
        record_flight(vid, record, settings)
    frames = [e for e in Replay(record, speed=0).events() if isinstance(e, Frame)]
    return Navigator(Tracker(vid)), frames


def _measure(report: Report, navigator: Navigator, frames: list[Frame], settings: dict[str, Any]) -> None:
    memory, lag, states = [], [], {"tracking": 0, "searching": 0, "lost": 0}
    rate, begun = settings["rate_hz"], 0.0
    with navigator:
        for warm in frames[:15]:  # the first pictures of a process are slower
            navigator.take(warm)
            navigator.wait()
        navigator.results()
        navigator.forget_place()
        located, passed, begun = navigator.located, navigator.passed_over, time.monotonic()
        navigator.latencies.clear()
        for number, frame in enumerate(at_rate(frames, rate, 60 * settings["minutes"])):
            navigator.take(frame)
            for result in navigator.results():
                states[result.row.get("state", "lost")] += 1
                lag.append(1e3 * result.row.get("latency_s", 0.0))
            if number % int(rate) == 0:
                memory.append(resident_mb())
        navigator.wait()
        seconds = time.monotonic() - begun
        latencies = list(navigator.latencies)
    total = [1e3 * x.total_s for x in latencies]
    group = f"{len(navigator.vid)} views, {rate:g} pictures a second for {settings['minutes']:g} min"
    report.add(group, "picture to pose", "ms", total)
    report.add(group, "picture to pose, 95th percentile", "ms", [float(np.percentile(total, 95))], n=len(total))
    report.add(group, "of that, waiting", "ms", [1e3 * x.waiting_s for x in latencies])
    report.add(group, "of that, features", "ms", [1e3 * x.features_s for x in latencies])
    report.add(group, "of that, tracking", "ms", [1e3 * x.tracking_s for x in latencies])
    report.add(group, "coverage and route, beside", "ms", [1e3 * x.painting_s for x in latencies])
    report.add(group, "poses a second", "1/s", [(navigator.located - located) / seconds], n=len(total))
    report.add(group, "pictures passed over", "pictures", [float(navigator.passed_over - passed)], n=len(total))
    report.add(group, "tracking", "%", [100.0 * states["tracking"] / max(sum(states.values()), 1)], n=len(total))
    third = max(len(lag) // 3, 1)
    drift = float(np.median(lag[-third:]) - np.median(lag[:third])) if lag else 0.0
    report.add(group, "pose time less frame time, last third less first", "ms", [drift], n=len(lag))
    third = max(len(memory) // 3, 1)
    growth = float(np.median(memory[-third:]) - np.median(memory[:third]))
    report.add(group, "memory", "MB", memory)
    report.add(group, "memory, last third less first", "MB", [growth], n=len(memory))


def at_rate(frames: list[Frame], rate_hz: float, seconds: float) -> Iterator[Frame]:
    """The pictures forth and back, without a jump, each stamped with the time at which it is given."""
    there_and_back = frames + frames[-2:0:-1]
    begun = time.monotonic()
    for number in range(int(rate_hz * seconds)):
        time.sleep(max(0.0, begun + number / rate_hz - time.monotonic()))
        frame = there_and_back[number % len(there_and_back)]
        yield replace(frame, stamp=Stamp(number, time.monotonic(), time.time()))


def phantom_vid(settings: dict[str, Any], folder: Path) -> Vid:
    lens = equidistant_camera(160.0, settings["lens_px"], settings["lens_px"])
    plan = PlanSettings(views_per_calyx=settings["views_per_calyx"], passage_views=settings["views_per_calyx"])
    return build_vid(make_phantom_kidney(0, calyces=8), lens, DefaultSettings(), RaycastRenderer, plan, folder)


def record_flight(vid: Vid, path: Path, settings: dict[str, Any]) -> None:
    """Draw a flight along the centerline into the calyces in turn, at 6 mm/s, as a camera would see it."""
    rng = np.random.default_rng(0)
    renderer, faults = RaycastRenderer(vid.kidney.mesh, vid.camera), severity(settings["sensor"], 0.5, rng)
    with Recorder(path) as recorder:
        for i, T in enumerate(flight(vid, settings["rate_hz"], settings["flight_s"])):
            stamp = Stamp(i, i / settings["rate_hz"], 1e9 + i / settings["rate_hz"])
            recorder.write(Frame(stamp, simulate(renderer, T, faults, rng)))


def flight(vid: Vid, rate_hz: float, seconds: float, speed_mm_s: float = 6.0) -> Iterator[Any]:
    """Poses (4, 4) of a scope that visits the calyces in turn, in and out, with a steady gaze along the way."""
    tree, unit = vid.kidney.centerline, vid.kidney.scale
    places = []
    for calyx in range(len(vid.kidney.calyces)):
        points = tree.points_mm[tree.path_to(calyx)]
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        at = np.arange(0.0, max(along[-1] - 5.0 * unit, 1.0), speed_mm_s / rate_hz)
        way = np.stack([np.interp(at, along, points[:, k]) for k in range(3)], 1)
        ahead = np.stack([np.interp(at + 6.0 * unit, along, points[:, k]) for k in range(3)], 1)
        places += [*zip(way, ahead, strict=True), *reversed(list(zip(way, ahead, strict=True)))]
    gaze, up = None, None
    for number in range(int(rate_hz * seconds)):
        position, goal = places[number % len(places)]
        wanted = (goal - position) / np.linalg.norm(goal - position)
        gaze = wanted if gaze is None else gaze + 0.15 * (wanted - gaze)
        gaze = gaze / np.linalg.norm(gaze)
        across = np.cross(gaze, [0.3, 0.5, 0.8]) if up is None else np.cross(up, gaze)
        across /= np.linalg.norm(across)
        up = np.cross(gaze, across)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = np.stack([across, up, gaze], axis=1), position
        yield T
