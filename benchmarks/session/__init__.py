"""A long simulated session: does anything get lost, does memory grow, does the replay give the same rows?

    python -m benchmarks.session              # ten minutes and the replay
    python -m benchmarks.session minutes=1
    python -m benchmarks.session minutes=30 faults_every_s=10   # a soak: a fault every ten seconds, nothing is located;
                                                                # kept as suite "soak"

The scope flies through the phantom by its pilot, at 15 pictures, 40 EM samples and 50 commands a second; all of it is
recorded, pictures are located in a VID of the phantom, and the record is replayed and located again.
"""

import json
import os
import re
import tempfile
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.session.faults import Faults, Operator
from benchmarks.session.watching import Watching
from benchmarks.shared.results import Report, overrides, resident_mb
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.devices import Frame, Note, RobotLight
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.pictures import match_row
from ursnav_torch.session import Event, Live, Player, Recorder, Replay, Result, Rig, Summary, build_rig, run_session
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
    "faults_every_s": 0.0,
    "out": "",
}
TRACKERS = {"openigtlink": SimulatedOpenIgtlTracker, "ndi": SimulatedNdiTracker}
#: What is said of a device that works again, and by how much it rounds.
OUTAGE, OUTAGE_S = re.compile(r"again after (\d+\.\d) s"), 0.1
RATES_HZ = {"Frame": 15.0, "TrackerSample": 40.0, "CommandSample": 50.0}


def main(arguments: list[str]) -> None:
    """Run the session, the replay, and print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    report = Report("soak" if settings["faults_every_s"] else "session", settings)
    with tempfile.TemporaryDirectory() as folder:
        (_soak if settings["faults_every_s"] else _measure)(report, settings, Path(folder))
    report.finish(settings["out"])


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


def _soak(report: Report, settings: dict[str, Any], folder: Path) -> None:
    """Faults on a clock: memory, threads, descriptors, and whether every sample that was sent has come or was noted."""
    kidney = make_phantom_kidney(0, calyces=6)
    lens = equidistant_camera(160.0, settings["lens_px"], settings["lens_px"])
    rig = _rig(World(kidney, RaycastRenderer(kidney.mesh, lens)), settings)
    assert rig.robot is not None and rig.gamepad is not None
    operator = Operator(rig.gamepad, rig.robot)
    looks: list[tuple[float, float, int, int]] = []
    outages: list[tuple[float, float]] = []

    def look(event: Event) -> None:
        if isinstance(event, Note) and (found := OUTAGE.search(event.text)) and "Tracker" in event.text:
            outages.append((event.stamp.t_mono_s - float(found[1]) - OUTAGE_S, event.stamp.t_mono_s))
        if not looks or time.monotonic() - looks[-1][0] >= 1.0:
            looks.append((time.monotonic(), resident_mb(), threading.active_count(), len(os.listdir("/proc/self/fd"))))

    with (
        Watching(kidney, lens, folder / "vid") as watching,
        replace(rig, gamepad=operator) as rig,
        Recorder(folder / "record", settings) as recorder,
    ):
        live = Live(rig, duration_s=60 * settings["minutes"])
        with Faults(rig, settings["faults_every_s"], watching.reload) as faults:
            summary = run_session(live, None, [recorder.write, look, watching.show])
    _add_soak(report, summary, looks)
    missed = len(faults.sent_s) - summary.counts["TrackerSample"]
    during = sum(any(begun <= t <= ended for begun, ended in outages) for t in faults.sent_s)
    report.add("EM poses", "sent and not come", "samples", [float(missed)], n=len(faults.sent_s))
    report.add("EM poses", "sent while a connection was down, as was noted", "samples", [float(during)])
    report.add("EM poses", "unaccounted for", "samples", [float(max(missed - during, 0))], n=len(faults.sent_s))
    for name, count in sorted(faults.planted.items()):
        report.add("faults planted", name.replace("_", " "), "times", [float(count)])
    report.add("page", "opened", "times", [float(watching.reloads)])
    report.add("page", "messages that arrived", "messages", [float(watching.heard)])
    report.add("operator", "stops acknowledged", "times", [float(operator.acknowledged)])
    report.add("operator", "lost places confirmed", "times", [float(operator.confirmed)])
    replay = Replay(folder / "record", speed=0)
    again = run_session(Player(replay), None, [])
    report.add("replay", "events that differ from the session's", "events", [
        float(sum(abs(again.counts.get(k, 0) - n) for k, n in summary.counts.items()) + replay.damaged)
    ])  # fmt: skip
    print(summary.text())


def _add_soak(report: Report, summary: Summary, looks: list[tuple[float, float, int, int]]) -> None:
    t, memory, threads, descriptors = np.array(looks).T
    settled = t > t[0] + (t[-1] - t[0]) / 3
    slope = float(np.polyfit(t[settled] / 60, memory[settled] / 1.048576, 1)[0])
    group = f"soak of {summary.seconds / 60:.1f} min"
    report.add(group, "memory slope over the last two thirds", "MiB/min", [slope])
    for name, values in (("threads", threads), ("descriptors", descriptors)):
        first, second = np.array_split(values[settled], 2)
        report.add(group, f"{name}, second half less first", name, [float(np.median(second) - np.median(first))])
    report.add(group, "faults noted", "notes", [float(len(summary.faults))])
    for name, seconds in summary.outages_s.items():
        report.add(group, f"{name} gave nothing", "s", [seconds])
    for kind in RATES_HZ:
        report.add(group, f"{kind} lost", "samples", [float(summary.lost.get(kind, 0))], n=summary.counts.get(kind, 0))


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
