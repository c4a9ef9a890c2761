"""A long simulated session: does anything get lost, does memory grow, does the replay give the same rows?

    python -m benchmarks.session              # ten minutes and the replay
    python -m benchmarks.session minutes=1

The scope flies through the phantom by its pilot, at 15 pictures, 40 EM samples and 50 commands a second; all of it is
recorded, pictures are located in a VID of the phantom, and the record is replayed and located again.
"""

import json
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shared.results import Report, overrides, resident_mb
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.devices import Frame, RobotLight
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.pictures import match_row
from ursnav_torch.session import Event, Live, Player, Recorder, Replay, Result, Rig, build_rig, run_session
from ursnav_torch.simulation import (
    SimulatedGrblRobot,
    SimulatedNdiTracker,
    SimulatedOpenIgtlTracker,
    TwinCamera,
    TwinPilot,
    World,
    make_twin,
)
from ursnav_torch.vid import PlanSettings, build_vid

SETTINGS = {
    "minutes": 10.0,
    "lens_px": 250,
    "sensor": "none",
    "tracker": "openigtlink",
    "views_per_calyx": 24,
    "out": "",
}
TRACKERS = {"openigtlink": SimulatedOpenIgtlTracker, "ndi": SimulatedNdiTracker}
RATES_HZ = {"Frame": 15.0, "TrackerSample": 40.0, "CommandSample": 50.0}


def main(arguments: list[str]) -> None:
    """Run the session, the replay, and print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    report = Report("session", settings)
    with tempfile.TemporaryDirectory() as folder:
        _measure(report, settings, Path(folder))
    print(report.table())
    print(f"\nwritten to {report.write(Path(settings['out']) if settings['out'] else None)}")


def _measure(report: Report, settings: dict[str, Any], folder: Path) -> None:
    world, worker = _prepare(settings, folder)
    memory: list[float] = []
    rows: list[tuple[int, int]] = []
    with _rig(world, settings) as rig, Recorder(folder / "record", settings) as recorder:
        live = Live(rig, duration_s=60 * settings["minutes"])
        summary = run_session(live, worker, [recorder.write, _watch(memory, rows)])
    for kind, rate in RATES_HZ.items():
        made = summary.counts.get(kind, 0) / summary.seconds
        report.add("session", f"{kind} a second, {rate:g} wanted", "1/s", [made], n=summary.counts.get(kind, 0))
        report.add("session", f"{kind} lost", "samples", [float(summary.lost.get(kind, 0))])
    report.add("session", "events dropped", "events", [float(summary.dropped)])
    report.add("session", "longest control cycle", "ms", [1e3 * live.longest_cycle_s])
    settled = memory[min(len(memory) // 5, 60) :]
    thirds = len(settled) // 3
    growth = float(np.median(settled[-thirds:]) - np.median(settled[:thirds]))
    report.add("session", "memory", "MB", settled)
    report.add("session", "memory, last third less first", "MB", [growth])
    again: list[tuple[int, int]] = []
    begun = time.monotonic()
    replay = Replay(folder / "record", speed=0)
    run_session(Player(replay), worker, [_watch([], again)])
    same = sum(a == b for a, b in zip(rows, again, strict=False)) if len(rows) == len(again) else 0
    report.add("replay", "rows that are the same", "%", [100.0 * same / max(len(rows), 1)], n=len(rows))
    report.add("replay", "damaged items", "items", [float(replay.damaged)])
    report.add("replay", "seconds", "s", [time.monotonic() - begun])


def _prepare(settings: dict[str, Any], folder: Path) -> tuple[World, "Locating"]:
    """The phantom, what draws it, and what locates its pictures."""
    kidney = make_phantom_kidney(0, calyces=6)
    lens = equidistant_camera(160.0, settings["lens_px"], settings["lens_px"])
    plan = PlanSettings(views_per_calyx=settings["views_per_calyx"], passage_views=settings["views_per_calyx"])
    localizer = Localizer(build_vid(kidney, lens, DefaultSettings(), RaycastRenderer, plan, folder / "vid", workers=1))

    return World(kidney, RaycastRenderer(kidney.mesh, lens)), Locating(localizer)


class Locating:
    """A worker that locates every picture at once."""

    def __init__(self, localizer: Localizer) -> None:
        self._localizer, self._made = localizer, list[Result]()

    def take(self, event: Event) -> None:
        """Locate a picture; other events are passed over."""
        if isinstance(event, Frame):
            row = match_row(self._localizer.locate(event.image))
            row.pop("seconds")
            self._made.append(Result(event.stamp, event.stamp.sequence, row))

    def wait(self) -> bool:
        """Nothing is ever left to do."""
        return True

    def results(self) -> list[Result]:
        """The results since the last call."""
        made, self._made = self._made, []
        return made


def _rig(world: World, settings: dict[str, Any]) -> Rig:
    sensor = None if settings["sensor"] == "none" else settings["sensor"]
    return build_rig(
        camera=partial(TwinCamera),
        tracker=partial(TRACKERS[settings["tracker"]]),
        robot=partial(SimulatedGrblRobot),
        light=partial(RobotLight),
        gamepad=partial(TwinPilot, rounds=0),
        twin=partial(make_twin, sensor=sensor),
        world=lambda: world,
    )


def _watch(memory: list[float], rows: list[tuple[int, int]]) -> Callable[[Event], None]:
    """Keep every result's picture number and its row's checksum, and once a second the memory in use in MB."""

    def watch(event: Event) -> None:
        if isinstance(event, Result):
            rows.append((event.frame, zlib.crc32(json.dumps(event.row).encode())))
        elif isinstance(event, Frame) and event.stamp.sequence % 15 == 0:
            memory.append(resident_mb())

    return watch
