"""Resets, power cuts and unpluggings at random moments: is the place true or unknown, and do the limits hold?"""

import contextlib
import random
import time
from dataclasses import dataclass, field

from benchmarks.safety.bench import Bench
from ursnav_torch.devices import Joints, Limits, Robot, RobotSample
from ursnav_torch.devices.robots.safety import STOPPED
from ursnav_torch.errors import DeviceError

LIMITS = Limits(max_insertion_mm=6.0)
#: What a place that is said to be known may be off: a GRBL board reports thousandths of a mm, an Arduino is up to
#: 0.15 s behind at 8 mm/s, and both may have been asked in mid-motion.
OFF_MM = 0.05
#: What it may move past a limit that holds for the true place: an order replaces the one before by the board's clock,
#: which the host knows to about 12 ms.
PAST_MM = 0.1


@dataclass(slots=True)
class Faced:
    """What came of the faults: how many of each, and how often the place stayed known, was false, or passed a limit."""

    counts: dict[str, int] = field(default_factory=dict)
    known: int = 0
    false: list[str] = field(default_factory=list)
    past: list[str] = field(default_factory=list)
    unended: list[str] = field(default_factory=list)


def face_faults(bench: Bench, count: int, seed: int = 3) -> Faced:
    """Drive, suffer a fault, recover; the operator confirms what is unknown, and drives on within the limits."""
    draw, faced = random.Random(seed), Faced()
    for number in range(count):
        fault = draw.choice(("reset", "silent reset", "power cut", "unplugged", "unplugged, power kept"))
        faced.counts[fault] = faced.counts.get(fault, 0) + 1
        if not bench.robot.arm():
            faced.unended.append(f"{number} {fault}: {bench.robot.why_not_armed}")
        bench.drive(draw.choice([-8.0, 8.0]), draw.uniform(0.05, 0.4))
        if draw.random() < 0.3:
            bench.robot.stop()
            bench.come_to_rest()
        _suffer(bench, fault, draw)
        with contextlib.suppress(DeviceError):
            bench.drive(draw.choice([-8.0, 8.0]), 0.1)  # nobody has noticed
        _recover(bench, f"{number} {fault}", faced)
        low, high = bench.farthest_mm
        if low < -PAST_MM or high > LIMITS.max_insertion_mm + PAST_MM:
            faced.past.append(f"{number} {fault}: {low:.2f} to {high:.2f} mm")
            bench.farthest_mm = 0.0, 0.0
    return faced


def _suffer(bench: Bench, fault: str, draw: random.Random) -> None:
    if fault.startswith("unplugged"):
        bench.unplug(draw.uniform(0.0, 0.2), keeps_power="kept" in fault)
    elif fault == "power cut":
        bench.cut_power(draw.uniform(0.05, 0.3))
    else:
        bench.reset(heard=fault == "reset")
    time.sleep(draw.uniform(0.0, 0.1))


def _recover(bench: Bench, what: str, faced: Faced) -> None:
    """Read until the fault is noticed, or stop by hand; acknowledge; compare what is said with what is true."""
    robot, end = bench.robot, time.monotonic() + 1.0
    while robot.gate.state != STOPPED and time.monotonic() < end:
        with contextlib.suppress(DeviceError):
            robot.read()
    robot.emergency_stop("operator")
    bench.come_to_rest()
    time.sleep(0.25)
    sample = None
    for _ in range(20):  # a board takes its time to start
        with contextlib.suppress(DeviceError):
            robot.acknowledge()
            sample = robot.read()
            break
        time.sleep(0.1)
    for _ in range(3):  # reading goes on, as in a session
        with contextlib.suppress(DeviceError):
            sample = robot.read()
    if sample is None:
        faced.unended.append(f"{what}: it did not come back")
        return
    slack, true = bench.slack_mm(), bench.true_mm()
    if sample.place_known:
        faced.known += 1
    else:
        if robot.arm():
            faced.false.append(f"{what}: armed while its place is unknown")
        robot.confirm_place()
        sample = _said(robot) or sample
        slack = bench.slack_mm()
    if abs(sample.joints.insertion_mm - true) > slack + OFF_MM:
        faced.false.append(f"{what}: said {sample.joints.insertion_mm:.2f}, true {true:.2f}, slack {slack:.2f} mm")
    if slack > 1.0:  # the operator looks it up before the slack eats up the way
        robot.set_place(Joints(insertion_mm=true))


def _said(robot: Robot) -> RobotSample | None:
    """What the robot says of itself; a machine so busy that its board answers late is asked again."""
    for _ in range(5):
        with contextlib.suppress(DeviceError):
            robot.acknowledge()
            return robot.read()
    return None
