"""Stones found, placed and sized on flights through phantoms: ``python -m benchmarks.stones work=DIR``.

A phantom of 6 to 12 calyces holds 0 to 4 stones of 2 to 8 mm as solids on its wall, which keep the scope away as the
wall does; a flight past them has breathing, slack and the faults of pictures from a patient. The stones' map gets true
poses first, then those that the tracker finds with odometry. Arguments, each ``key=value``: ``work=DIR`` (pictures,
drawn where they are not there), ``half=judging`` or ``choosing``, ``kidneys=20``, ``tracked=0`` (so many of them with
the tracker's poses, too), ``views=40`` (of a calyx, of their VIDs), ``vary=name=value,value`` (a setting of the map
instead of what is set; only with the choosing half), ``pictures=DIR`` (the stones found, to be looked at),
``out=FILE.json``.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.shared.statistics import wilson
from benchmarks.shared.vary import named_values, with_value
from benchmarks.stones.bodies import bodies_of
from benchmarks.stones.flights import CHOOSING, JUDGING, StoneFlight, stone_flight
from benchmarks.stones.scores import Poses, Score, mapped
from benchmarks.stones.tracked import tracked_poses
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.files import write_image
from ursnav_torch.reports.stones import draw_stones
from ursnav_torch.stones import FoundStone, StoneMap, StoneMapSettings, StoneWatch

DEFAULTS = {
    "work": "", "half": "judging", "kidneys": 20, "tracked": 0, "views": 40, "vary": "", "pictures": "", "out": "",
}  # fmt: skip
#: Standard deviations of a true pose: it is told by the twin, the lumen by voxels.
TRUE_SD = (0.1, 0.01)


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its table and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the flights' pictures")
    if settings["half"] not in ("choosing", "judging"):
        raise InputError(f"half={settings['half']!r} must be choosing or judging.")
    torch.set_num_threads(1)
    first = CHOOSING if settings["half"] == "choosing" else JUDGING
    choices = _choices(settings["vary"], settings["half"])
    camera = equidistant_camera()
    working = DefaultExtractor(DefaultSettings(), camera).working_camera
    scores: dict[tuple[str, str], Score] = {}
    for number in range(settings["kidneys"]):
        flight = stone_flight(first + number, work)
        bodies = bodies_of(flight, camera)
        ways: dict[str, Poses] = {"true poses": lambda i, T=flight.T_kidney_camera: (T[i], TRUE_SD)}
        if number < settings["tracked"]:
            ways["tracked poses"] = tracked_poses(flight, settings["views"], work)
        for way, poses in ways.items():
            for name, choice in choices.items():
                stones = mapped(flight, bodies, poses, working, choice)
                told = stones.stones()
                scores.setdefault((way, name), Score()).add(flight, told, stones.calyx_of)
                if settings["pictures"]:
                    _draw(flight, told, bodies, Path(settings["pictures"]) / f"{flight.seed}_{way[:4]}.png")
    report = Report("stones", {key: settings[key] for key in ("half", "kidneys", "tracked", "views", "vary")})
    for (way, name), score in scores.items():
        _tell(report, f"{way}{f', {name}' if name else ''}", score)
    report.finish(settings["out"])
    return 0


def _choices(vary: str, half: str) -> dict[str, StoneMapSettings]:
    """Settings by what is varied in them."""
    if not vary:
        return {"": StoneMapSettings()}
    if half != "choosing":
        raise InputError("vary= chooses settings: that is what half=choosing is for.")
    name, values = named_values(vary)
    return {f"{name}={value}": with_value(StoneMapSettings(), name, value) for value in values}


def _tell(report: Report, group: str, score: Score) -> None:
    """Rows of one way to get poses."""
    for what, good, of in (
        ("stones that the flight showed, found", score.found_shown, score.shown),
        ("all stones, found", score.found, score.there),
        ("calyx right, of those found", sum(score.right_calyx), len(score.right_calyx)),
        ("place within two standard deviations", _within(score), len(score.off_mm)),
    ):
        low, high = wilson(good, of)
        note = f"{good}/{of}, 95 % interval {100 * low:.0f} to {100 * high:.0f} %"
        report.add(group, what, "%", [100 * good / max(of, 1)], note, max(of, 1))
    report.add(
        group, "false stones, a kidney", "stones", [score.false / score.kidneys], f"{score.false}", score.kidneys
    )
    if score.off_mm:
        report.add(group, "error of the place", "mm", score.off_mm)
        report.add(group, "error of the size", "%", [100 * abs(s) for s in score.size_share])
        report.add(group, "size told too large by", "%", [100 * s for s in score.size_share])


def _within(score: Score) -> int:
    return sum(off <= 2 * np.sqrt(3) * sd for off, sd in zip(score.off_mm, score.sd_mm, strict=True))


def _draw(
    flight: StoneFlight,
    told: Sequence[FoundStone],
    bodies: Sequence[tuple[ForegroundBody, ...]],
    path: Path,
) -> None:
    """The stones told in the translucent kidney, and their best pictures."""
    watch = StoneWatch(StoneMap(flight.kidney, flight.lumen, equidistant_camera()))
    images = dict(enumerate(flight.images()))
    watch.pictures = {s.frame: (images[s.frame], bodies[s.frame]) for s in told}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, draw_stones(flight.kidney, watch, told))
