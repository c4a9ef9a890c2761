"""The rules that keep the robot safe, as plain functions and one small state machine."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ursnav_torch.devices.base import JointRates, Joints
from ursnav_torch.errors import InputError

DISARMED, ARMED, STOPPED = "disarmed", "armed", "stopped"
STRAIGHT = Joints()


@dataclass(frozen=True, slots=True)
class Limits:
    """Where the joints may go and how fast.

    Raises:
        InputError: a limit is not positive.
    """

    max_bend_rad: float = math.radians(120.0)
    max_insertion_mm: float = 120.0
    max_bend_rate_rad_s: float = math.radians(40.0)
    max_insertion_rate_mm_s: float = 8.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise InputError(f"Limit {name} must be positive, got {getattr(self, name)}.")


def clamp_rates(
    wanted: JointRates, joints: Joints, limits: Limits, horizon_s: float, slack: Joints = STRAIGHT
) -> JointRates:
    """The rates nearest to ``wanted`` that keep the speed caps and, for ``horizon_s``, the joint limits.

    The direction of a bend is kept when its speed is capped. A rate that is not finite counts as zero.

    Args:
        wanted: the operator's wish.
        joints: where the robot stands.
        limits: what it must keep.
        horizon_s: for how long.
        slack: how far the true joints may be from ``joints``; the limits are kept wherever they are.
    """
    bx, by = (v if math.isfinite(v) else 0.0 for v in (wanted.bend_x_rad_s, wanted.bend_y_rad_s))
    insertion = wanted.insertion_mm_s if math.isfinite(wanted.insertion_mm_s) else 0.0
    speed = math.hypot(bx, by)
    if speed > limits.max_bend_rate_rad_s:
        bx, by = (v * limits.max_bend_rate_rad_s / speed for v in (bx, by))
    may_bend = max(limits.max_bend_rad - math.hypot(slack.bend_x_rad, slack.bend_y_rad), 0.0)
    bx, by = _keep_bend(bx, by, joints, may_bend, horizon_s)
    cap = limits.max_insertion_rate_mm_s
    insertion = min(max(insertion, -cap), cap)
    low = (slack.insertion_mm - joints.insertion_mm) / horizon_s
    high = (limits.max_insertion_mm - slack.insertion_mm - joints.insertion_mm) / horizon_s
    return JointRates(bx, by, min(max(insertion, min(low, 0.0)), max(high, 0.0)))


def _keep_bend(bx: float, by: float, joints: Joints, max_bend: float, horizon_s: float) -> tuple[float, float]:
    """Make a bend rate end inside the limit circle (or the one we stand on, if already outside)."""
    x, y = joints.bend_x_rad, joints.bend_y_rad
    goal_x, goal_y = x + bx * horizon_s, y + by * horizon_s
    radius, ahead = max(max_bend, math.hypot(x, y)), math.hypot(goal_x, goal_y)
    if ahead <= radius:
        return bx, by
    return (goal_x * radius / ahead - x) / horizon_s, (goal_y * radius / ahead - y) / horizon_s


class SafetyGate:
    """Decides whether a command may move the robot; starts disarmed.

    Threads may share it. After a stop nothing moves until `acknowledge` and then `arm`.

    Args:
        clock: seconds by which commands are late; a simulation may run by one of its own.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._lock, self._clock = threading.RLock(), clock
        self._state, self.reason = DISARMED, "not armed yet"
        self.stops = 0  # that were asked for until now
        self.last_command_s = -math.inf

    @property
    def state(self) -> str:
        """``disarmed``, ``armed`` or ``stopped``."""
        return self._state

    def arm(self) -> bool:
        """Allow motion; False after a stop that was not acknowledged."""
        with self._lock:
            if self._state == DISARMED:
                self._state, self.reason = ARMED, ""
                self.last_command_s = self._clock()
            return self._state == ARMED

    def disarm(self, reason: str = "disarmed") -> None:
        """Forbid motion until `arm`; a stop stays a stop."""
        with self._lock:
            if self._state == ARMED:
                self._state, self.reason = DISARMED, reason

    def emergency_stop(self, reason: str) -> None:
        """Forbid motion until `acknowledge` and `arm`; the first reason stays."""
        with self._lock:
            self.stops += 1
            if self._state != STOPPED:
                self._state, self.reason = STOPPED, reason

    def acknowledge(self, stops: int | None = None) -> None:
        """Take note of the first so many stops, or of all: back to disarmed, unless another came since."""
        with self._lock:
            if self._state == STOPPED and stops in (None, self.stops):
                self._state, self.reason = DISARMED, "stop acknowledged, not armed yet"

    def is_stale(self, watchdog_s: float) -> bool:
        """True when the robot is armed and nobody has commanded it for ``watchdog_s``."""
        return self._state == ARMED and self._clock() - self.last_command_s > watchdog_s

    def refusal(self, dead_man: bool) -> str:
        """Why a command may not move the robot now; empty when it may. Feeds the watchdog."""
        self.last_command_s = self._clock()
        if self._state != ARMED:
            return f"{self._state}: {self.reason}"
        return "" if dead_man else "dead-man button not held"
