"""What keeps the robot safe, measured: lost places, and how far it moves on when its program is frozen or dead.

    python -m benchmarks.safety                       # 50 faults and 10 freezes of each kind, on both boards
    python -m benchmarks.safety faults=10 freezes=2

The bars: after every reset, power cut and unplugging the place is true (within what the robot says) or said to be
unknown; the robot never passes the limits that hold for its true place; a frozen or dead program at 8 mm/s moves the
robot on for 0.15 s and 1.2 mm at most. Exit code 1 where they do not hold.
"""

import random
import sys
from typing import Any

from benchmarks.safety.bench import KINDS, Bench
from benchmarks.safety.frozen import SPEED_MM_S, WAYS, freeze
from benchmarks.safety.resets import LIMITS, face_faults
from benchmarks.shared.results import Report, overrides
from ursnav_torch.devices.robots.robot import BLIND_S

SETTINGS = {"faults": 50, "freezes": 10, "seed": 3, "out": ""}
#: A program may have sent its last command this long before it is seen to be frozen, on a busy machine a little more.
SEEN_S = 0.02


def main(arguments: list[str]) -> int:
    """Measure on both boards, print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    report = Report("safety", settings)
    held = [measure(report, kind, settings) for kind in KINDS for measure in (_faults, _freezes)]
    report.finish(str(settings["out"]))
    return int(not all(held))


def _faults(report: Report, kind: str, settings: dict[str, Any]) -> bool:
    with Bench(kind, LIMITS) as bench:
        faced = face_faults(bench, int(settings["faults"]), int(settings["seed"]))
    counts = ", ".join(f"{count} {name}" for name, count in sorted(faced.counts.items()))
    n = max(sum(faced.counts.values()), 1)
    group = f"{kind}: {counts}"
    report.add(group, "place said to be known and false", "times", [float(len(faced.false))], n=n)
    report.add(group, "limits of the true place passed", "times", [float(len(faced.past))], n=n)
    report.add(group, "not brought back by acknowledging", "times", [float(len(faced.unended))], n=n)
    report.add(group, "place still known", "times", [float(faced.known)], n=n)
    for text in [*faced.false, *faced.past, *faced.unended]:
        print(f"{kind}: {text}", file=sys.stderr)
    return not (faced.false or faced.past or faced.unended)


def _freezes(report: Report, kind: str, settings: dict[str, Any]) -> bool:
    held = True
    for how in WAYS if int(settings["freezes"]) else ():
        draw = random.Random(f"{settings['seed']}/{kind}/{how}")
        moved = [freeze(kind, how, draw) for _ in range(int(settings["freezes"]))]
        seconds, mm = zip(*moved, strict=True)
        group = f"{kind}: {how} at {SPEED_MM_S:g} mm/s"
        report.add(group, "moves on for", "s", list(seconds))
        report.add(group, "moves on by", "mm", list(mm))
        report.add(group, "moves on for, at most", "s", [max(seconds)], n=len(moved))
        report.add(group, "moves on by, at most", "mm", [max(mm)], n=len(moved))
        held &= max(mm) <= SPEED_MM_S * BLIND_S and max(seconds) <= BLIND_S + SEEN_S
    return held
