"""A robot and a camera in simulated time.

The robot's controller is arithmetic; its gate, limits and watchdog are every robot's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ursnav_torch.devices import CameraDevice, Drive, Frame, JointRates, Joints, Limits, Robot, Stamper
from ursnav_torch.devices.robots.safety import SafetyGate
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array
from ursnav_torch.simulation.twin import Twin


@dataclass(slots=True)
class SimulatedTime:
    """A clock that goes on when it is told to; called, it tells the time.

    Attributes:
        now_s: the time.
        answer_s: from a picture to its answer; what live tracking is to keep.
    """

    now_s: float = 0.0
    answer_s: float = 0.13

    def __call__(self) -> float:
        return self.now_s


class SteppedCamera(CameraDevice):
    """The twin's camera by simulated time: `read` takes a picture now and never waits.

    Args:
        twin: the scope.
        clock: the time.
        rate_hz: pictures a second.

    Attributes:
        due_s: when the next picture is due.

    Raises:
        InputError: the rate is not positive.
    """

    def __init__(self, twin: Twin, clock: SimulatedTime, rate_hz: float = 15.0) -> None:
        super().__init__()
        if rate_hz <= 0:
            raise InputError(f"rate_hz must be positive, got {rate_hz}.")
        self.twin, self._period_s, self.due_s = twin, 1 / rate_hz, 0.0
        self._stamp = Stamper(clock)

    def read(self, timeout_s: float = 1.0) -> Frame:
        """The picture of now; the next is due a period after this one was."""
        self._check_connected()
        self.due_s += self._period_s
        return Frame(self._stamp(), self.twin.image())

    def _open(self) -> None: ...

    def _close(self) -> None: ...


class SteppedRobot(Robot):
    """Moves by what it was sent last, for ``horizon_s`` at most, as time is told by a clock.

    Args:
        clock: simulated seconds.
        drive: cables, slider and segment.
        limits: joint limits and speed caps.
    """

    simulated = True

    def __init__(self, clock: Callable[[], float], drive: Drive | None = None, limits: Limits | None = None) -> None:
        super().__init__(limits or Limits(), horizon_s=0.12, watchdog_s=0.5, tolerance=1e-6)
        self.drive, self._clock = drive or Drive(), clock
        self.gate = SafetyGate(clock)
        self._stamp, self._command_stamp = Stamper(clock), Stamper(clock)
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
