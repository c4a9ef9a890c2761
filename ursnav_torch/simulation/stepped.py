"""A robot in simulated time: its controller is arithmetic, its gate, limits and watchdog are every robot's."""

from collections.abc import Callable

import numpy as np

from ursnav_torch.devices import Drive, JointRates, Joints, Limits, Robot, Stamper
from ursnav_torch.devices.robots.safety import SafetyGate
from ursnav_torch.geometry import Array


class SteppedRobot(Robot):
    """Moves by what it was sent last, for ``horizon_s`` at most, as time is told by a clock.

    Args:
        clock: simulated seconds.
        drive: cables, slider and segment.
        limits: joint limits and speed caps.
    """

    def __init__(self, clock: Callable[[], float], drive: Drive | None = None, limits: Limits | None = None) -> None:
        super().__init__(limits or Limits(), horizon_s=0.12, watchdog_s=0.5, tolerance=1e-6)
        self.drive, self._clock = drive or Drive(), clock
        self.gate = SafetyGate(clock)
        self._stamp = self._command_stamp = Stamper(clock)
        self._joints, self._rates = np.zeros(3), np.zeros(3)
        self._now_s = self._until_s = clock()
        self.light = 1.0

    def axes_mm(self) -> Array:
        """Where the axes are now, (3,) mm."""
        return self.drive.axes_mm(Joints(*self._advanced().tolist()))

    def set_light(self, level: float) -> float:
        """Dim the simulated lamp."""
        self.light = level
        return level

    def _advanced(self) -> Array:
        """The joints (3,) now: bends in radians, insertion in mm."""
        with self._lock:
            now = self._clock()
            self._joints = self._joints + self._rates * max(min(now, self._until_s) - self._now_s, 0.0)
            self._now_s = now
            return self._joints

    def _joints_of(self, axes: Array) -> Joints:
        return self.drive.joints(axes)

    def _axes_of(self, joints: Joints) -> Array:
        return self.drive.axes_mm(joints)

    def _joints_ahead(self) -> Joints:
        return Joints(*self._advanced().tolist())

    def _send(self, rates: JointRates) -> JointRates:
        self._advanced()
        self._rates = np.array([rates.bend_x_rad_s, rates.bend_y_rad_s, rates.insertion_mm_s])
        self._until_s = self._now_s + self.horizon_s
        self.place.sent(self._end())
        return rates

    def _end(self) -> Array:
        """Where (3,) the axes will be when all that was sent is done."""
        end = self._joints + max(self._until_s - self._now_s, 0.0) * self._rates
        return self._axes_of(Joints(*end.tolist()))

    def _halt(self) -> None:
        self._advanced()
        self._rates, self._until_s = np.zeros(3), self._now_s

    def _kill(self) -> None:
        self._halt()

    def _recover(self) -> None: ...

    def _recount(self, axes: Array) -> None: ...

    def _read_axes(self, timeout_s: float) -> bool:
        axes = self.axes_mm()
        self.place.report(axes, self._end())
        return bool(self._rates.any()) and self._now_s < self._until_s

    def _open(self) -> None: ...

    def _close(self) -> None: ...
