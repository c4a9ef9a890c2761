"""The robot's drive through the phantom: a pilot steers the twin into each calyx; pictures are chosen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.devices import JointRates, Joints, clamp_rates
from ursnav_torch.geometry import Array, angle_between
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.simulation import Twin, TwinPilot
from ursnav_torch.thesis.settings import ProtocolSettings

#: Commands a second, as `Control` sends them, and how often a pose is kept.
RATE_HZ, KEEP_EVERY = 50, 5
#: A drive that has not ended by then is cut off.
LONGEST_S = 900.0


@dataclass(frozen=True, slots=True)
class RobotDrive:
    """Where the scope was, ten times a second.

    Attributes:
        T_kidney_camera: (N, 4, 4).
        t_s: (N,) since the start.
        visited: names of the calyces that the tip came to.
    """

    T_kidney_camera: Array
    t_s: Array
    visited: tuple[str, ...]


def drive_robot(twin: Twin, kidney: Kidney, settings: ProtocolSettings) -> RobotDrive:
    """Steer the scope into every calyx and out again, in simulated time.

    The joints follow the operator's commands within the robot's limits, as its controller lets them; slack, walls and
    the shaft's give are the twin's.
    """
    pilot_input = _Driver(twin, kidney, settings)
    poses, times = [], []
    for cycle in range(int(LONGEST_S * RATE_HZ)):
        if not pilot_input.step():
            break
        if cycle % KEEP_EVERY == 0:
            poses.append(twin.pose())
            times.append(cycle / RATE_HZ)
    return RobotDrive(np.array(poses), np.array(times), tuple(pilot_input.pilot.visited))


class _Driver:
    """Joints that obey a pilot, one command at a time."""

    def __init__(self, twin: Twin, kidney: Kidney, settings: ProtocolSettings) -> None:
        self._twin, self._limits = twin, settings.limits
        self._joints, self._t_s = Joints(), 0.0
        self.pilot = TwinPilot(twin, kidney, clock=lambda: self._t_s)
        self.pilot.connect()
        twin.drive_with(lambda: twin.scope.drive.axes_mm(self._joints))

    def step(self) -> bool:
        """One cycle; False when the pilot is done."""
        hands = self.pilot.read()
        bend, push = self._limits.max_bend_rate_rad_s, self._limits.max_insertion_rate_mm_s
        wanted = JointRates(hands.bend_x * bend, hands.bend_y * bend, hands.insertion * push)
        rates = clamp_rates(wanted, self._joints, self._limits, 1 / RATE_HZ)
        self._joints = Joints(
            self._joints.bend_x_rad + rates.bend_x_rad_s / RATE_HZ,
            self._joints.bend_y_rad + rates.bend_y_rad_s / RATE_HZ,
            self._joints.insertion_mm + rates.insertion_mm_s / RATE_HZ,
        )
        self._t_s += 1 / RATE_HZ
        self._twin.pose()
        return not hands.quit


def choose_pictures(
    drive: RobotDrive, kidney: Kidney, lumen: LumenDistance, settings: ProtocolSettings
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the drive (M,) at which the operator takes pictures, and the calyx (M,) that each observes.

    Of the poses that observe a calyx from the distances and within the angle of `ProtocolSettings`, those in the
    middle of as many equal parts, from far to near, as there are pictures to take. Where too few are within the angle,
    the best aimed ones do.
    """
    T = drive.T_kidney_camera
    calyx, away = observed_calyx(T, kidney, lumen), lumen.to_calyces(T[:, :3, 3])
    aside = angle_between(kidney.tips_mm[None] - T[:, None, :3, 3], T[:, None, :3, 2])
    low, high = settings.nearest_mm * kidney.scale, settings.farthest_mm * kidney.scale
    rows, names = [], []
    for c in range(len(kidney.calyces)):
        able = np.flatnonzero((calyx == c) & (away[:, c] >= low) & (away[:, c] <= high))
        aimed = int(np.sum(aside[able, c] <= np.radians(settings.aim_deg)))
        able = able[np.argsort(aside[able, c], kind="stable")][: max(aimed, settings.pictures_per_calyx)]
        able = able[np.argsort(-away[able, c], kind="stable")]
        parts = np.array_split(able, settings.pictures_per_calyx)
        chosen = [int(part[len(part) // 2]) for part in parts if len(part)]
        rows += chosen
        names += [c] * len(chosen)
    return np.array(rows, np.int64), np.array(names, np.int64)
