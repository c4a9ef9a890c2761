"""A pilot for the twin: knows the truth and steers into one calyx after the other, so that a rig can run unattended."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ursnav_torch.devices import Gamepad, OperatorInput, Segment, Stamp, Stamper
from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney
from ursnav_torch.kinematics import turn_towards
from ursnav_torch.simulation.twin import Twin

AHEAD_MM, NEAR_MM = 3.5, 5.0
PATIENCE_S = 12.0
FULL_STICK_RAD = 0.35
#: Who leads a scope in for autonomy feels a shaft that is compressed by more, and pushes no further.
FELT_MM = 0.3


@dataclass(slots=True)
class Goal:
    """A way (N, 3) in the kidney frame into a calyx, and when it was begun."""

    name: str
    way_mm: Array
    begun_s: float | None = None


class TwinPilot(Gamepad):
    """An input device without an operator: flies the twin into the calyces in turn, out again, and quits at the end.

    A calyx that the scope cannot enter is given up after 12 s. Visited ones are listed in `visited`.

    Args:
        twin: the scope to fly; its motors are moved through the robot like an operator's.
        kidney: whose centerline to follow.
        calyces: names to visit in this order; all without it.
        rounds: how often; 0 for ever.
        clock: seconds by which patience is measured; for a twin that runs faster than the world.

    Attributes:
        hands_over: where autonomy is to fly: whether it may take over by now. Until it may, or the first calyx is
            reached, the pilot leads in, and gives a calyx up as soon as it feels that something is in the way; from
            then on it only holds the dead-man button. None where nobody else flies.
    """

    def __init__(
        self,
        twin: Twin,
        kidney: Kidney,
        calyces: Sequence[str] | None = None,
        rounds: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._stamp = Stamper(clock)
        self.twin, self.kidney, self.rounds = twin, kidney, rounds
        self._names = [c.name for c in kidney.calyces] if calyces is None else list(calyces)
        self._segment: Segment = twin.scope.drive.segment
        self.visited: list[str] = []
        self.hands_over: Callable[[], bool] | None = None
        self._handed_over = False
        self._goals: list[Goal] = []
        self._round = 0
        self._entering = True
        self._armed = False

    def read(self) -> OperatorInput:
        """What an operator who sees everything would do now."""
        self._check_connected()
        stamp = self._stamp()
        if not self._armed:
            self._armed = True
            return OperatorInput(stamp, arm=True)
        if self.hands_over is not None:
            self._handed_over |= bool(self.visited) or self.hands_over()
        if self._handed_over:
            return OperatorInput(stamp, dead_man=True)
        if not self._goals:
            self._round += 1
            if 0 < self.rounds < self._round:
                return OperatorInput(stamp, quit=True)
            self._goals, self._entering = self._plan(), True
        return self._enter(stamp) if self._entering else self._leave(stamp)

    def _plan(self) -> list[Goal]:
        names = [c.name for c in self.kidney.calyces]
        tree = self.kidney.centerline
        return [Goal(name, tree.points_mm[tree.path_to(names.index(name))]) for name in self._names]

    def _enter(self, stamp: Stamp) -> OperatorInput:
        """Steer along the way: turn towards a point ahead on it, advance while it lies ahead."""
        goal, T = self._goals[0], self.twin.pose()
        goal.begun_s = stamp.t_mono_s if goal.begun_s is None else goal.begun_s
        if np.linalg.norm(T[:3, 3] - goal.way_mm[-1]) < NEAR_MM:
            self.visited.append(goal.name)
            self._entering = False
        elif stamp.t_mono_s - goal.begun_s > PATIENCE_S or (
            self.hands_over is not None and self.twin.pressed_mm > FELT_MM
        ):
            self._entering = False
        target = _ahead(goal.way_mm, T[:3, 3])
        direction = T[:3, :3].T @ (target - T[:3, 3])
        bend = _bend_stick(self._segment, self.twin.bend, turn_towards(direction))
        cosine = float(direction[2] / max(np.linalg.norm(direction), 1e-9))
        drive = max(0.0, (cosine - 0.75) / 0.25)
        return OperatorInput(stamp, bend_x=bend[0], bend_y=bend[1], insertion=drive, dead_man=True)

    def _leave(self, stamp: Stamp) -> OperatorInput:
        """Straighten and withdraw until the tip is back in the pelvis, then take the next calyx."""
        if self.twin.insertion_mm < 1.0:
            self._goals.pop(0)
            self._entering = True
        back = np.clip(-self.twin.bend / FULL_STICK_RAD, -1, 1).tolist()
        return OperatorInput(stamp, bend_x=back[0], bend_y=back[1], insertion=-1.0, dead_man=True)

    def _open(self) -> None:
        self._goals, self._round, self._armed, self._entering, self._handed_over = [], 0, False, True, False

    def _close(self) -> None: ...


def _ahead(way_mm: Array, position: Array) -> Array:
    """The point of a way (N, 3) that lies 3.5 mm beyond the one nearest to ``position``."""
    nearest = int(np.linalg.norm(way_mm - position, axis=1).argmin())
    along = np.linalg.norm(np.diff(way_mm[nearest:], axis=0), axis=1).cumsum()
    return way_mm[min(nearest + 1 + int(np.searchsorted(along, AHEAD_MM)), len(way_mm) - 1)]


def _bend_stick(segment: Segment, bend: Array, turn: Array) -> list[float]:
    """Stick deflections that turn the tip by ``turn`` (2,) about its own x and y axes, at a bend (2,)."""
    wanted = segment.bend_for_turn(bend, turn) / FULL_STICK_RAD
    return np.asarray(wanted / max(1.0, float(np.abs(wanted).max()))).tolist()
