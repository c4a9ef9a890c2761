"""The robot's contract and what every robot has in common: gate, limits, watchdogs, stop on any fault, lost places."""

import atexit
import contextlib
import logging
import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.devices.base import CommandSample, Device, JointRates, Joints, RobotSample, Stamper
from ursnav_torch.devices.robots.guardian import Guardian
from ursnav_torch.devices.robots.kinematics import Drive
from ursnav_torch.devices.robots.place import Place
from ursnav_torch.devices.robots.safety import ARMED, STOPPED, Limits, SafetyGate, clamp_rates
from ursnav_torch.errors import DeviceError, InputError
from ursnav_torch.geometry import Array

logger = logging.getLogger(__name__)
#: No controller is ever given motion for longer than this, so that a dead host means a still robot.
MAX_QUEUED_S = 0.5
#: A controller that falls silent moves on for no longer than this: 1.2 mm at the slider's cap of 8 mm/s.
BLIND_S = 0.15


class Robot(Device):
    """A robot driven by rates, each command good for ``horizon_s`` at most.

    It starts disarmed. Every fault of the link, an alarm of the controller and `emergency_stop` stop it until
    `acknowledge` and `arm`. If it is armed and not commanded for ``watchdog_s``, it is stopped and disarmed, by a
    thread and, should the interpreter be frozen, by a process of its own; should that one end, the robot is stopped.

    A controller that was reset counts from zero wherever it stands: the place is then lost, `read` gives the last
    certain one, and nothing can be armed until `confirm_place` or `set_place`. Limits hold for the true place.

    Args:
        tolerance: how far (3,) the controller's reports may lie outside of what was sent, in its own unit.

    Attributes:
        drive: what its axes do to the joints; every driver has one.
        simulated: whether nothing real moves; only then may a page or a pilot arm and drive it.

    Raises:
        InputError: ``horizon_s`` is not between 0 and 0.15, or ``watchdog_s`` not above it up to 0.5.
    """

    drive: Drive
    simulated: ClassVar[bool] = False

    def __init__(self, limits: Limits, horizon_s: float, watchdog_s: float, tolerance: float | Array) -> None:
        super().__init__()
        if not 0 < horizon_s <= BLIND_S:
            raise InputError(f"horizon_s must lie between 0 and {BLIND_S} s, got {horizon_s}.")
        if not horizon_s < watchdog_s <= MAX_QUEUED_S:
            raise InputError(f"watchdog_s must lie between horizon_s and {MAX_QUEUED_S} s, got {watchdog_s}.")
        self.limits, self.horizon_s, self.watchdog_s = limits, horizon_s, watchdog_s
        self._ahead_s = horizon_s  # for how long a rate must keep the joint limits
        self.gate, self.place = SafetyGate(), Place(tolerance)
        self._command_stamp = Stamper()
        self._lock = threading.RLock()
        self._still = True
        self._watch_end = threading.Event()
        self._guardian: Guardian | None = None

    def connect(self) -> None:
        """Open the link and start the watchdog; raises as `Device.connect` does."""
        if self._connected:
            return
        super().connect()
        atexit.register(self.disconnect)
        self._watch_end.clear()
        threading.Thread(target=self._watch, name="robot-watchdog", daemon=True).start()

    def disconnect(self) -> None:
        """Stop, disarm and close; also done when the interpreter exits."""
        self._watch_end.set()
        self.gate.disarm("disconnected")
        super().disconnect()
        self._dismiss_guardian()
        atexit.unregister(self.disconnect)

    def arm(self) -> bool:
        """Allow motion; False after a stop that was not acknowledged, and while the place is lost."""
        self._check_connected()
        if not self.place.is_known:
            return False
        if self._guardian is not None and not self._guardian.is_alive:
            self._dismiss_guardian()
        if self._guardian is None and (stops := self._stops()):
            self._guardian = Guardian(stops, self.watchdog_s)
        return self.gate.arm()

    def disarm(self) -> None:
        """Stop and forbid motion until `arm`."""
        self.gate.disarm()
        self.stop()

    def emergency_stop(self, reason: str = "emergency stop") -> None:
        """Stop everything now, by the controller's hardest means, and stay so until `acknowledge`."""
        self.gate.emergency_stop(reason)
        self._still = True
        if self._connected:
            self._quietly(self._kill)

    def acknowledge(self) -> None:
        """After a stop: make the controller ready again and go back to disarmed, unless another stop comes meanwhile.

        Raises:
            DeviceError: the controller does not come back; the robot stays stopped.
        """
        self._check_connected()
        stops = self.gate.stops
        if self.gate.state != STOPPED:
            return
        with self._lock:
            self._recover()
        self.gate.acknowledge(stops)

    def confirm_place(self) -> None:
        """The operator confirms that a robot whose place was lost stands where it was last certain.

        Raises:
            DeviceError: the controller cannot be asked; the robot was stopped as well as it can be.
        """
        self._check_connected()
        if not self.place.is_known:
            with self._exchange():
                self._recount(self.place.axes)
                self.place.confirm()

    def set_place(self, joints: Joints) -> None:
        """The operator says where the robot stands, for example straight and withdrawn after homing by hand.

        Raises:
            DeviceError: the controller cannot be asked; the robot was stopped as well as it can be.
        """
        self._check_connected()
        axes = self._axes_of(joints)
        with self._exchange():
            self._recount(axes)
            self.place.set(axes)

    @property
    def why_not_armed(self) -> str:
        """Why `arm` was refused, and what to do about it."""
        if self.gate.state == STOPPED:
            return f"The robot is stopped ({self.gate.reason}); acknowledge the stop first."
        if self.place.is_known:
            return ""
        at = self._joints_of(self.place.axes)
        return (
            f"The robot's place is unknown: {self.place.why_lost}. It was last certain {at.insertion_mm:.1f} mm in, "
            f"bent by {at.bend_x_rad:.2f} and {at.bend_y_rad:.2f} rad; if it still stands there, acknowledge once "
            "more, else withdraw it by hand and connect again."
        )

    @property
    def reported(self) -> Joints:
        """Where the controller last said that it stands, without asking it; see `read`."""
        return self._joints_of(self.place.axes)

    def stop(self) -> None:
        """End all motion gently; arms nothing and disarms nothing."""
        self._still = True
        if self._connected:
            self._quietly(self._halt)

    def command(self, wanted: JointRates, dead_man: bool) -> CommandSample:
        """Move at ``wanted`` for the next ``horizon_s`` or until the next command.

        Args:
            wanted: the operator's wish.
            dead_man: whether the dead-man button is held; nothing moves without it.

        Returns:
            What was really sent, after gate, caps and limits, and why it differs.

        Raises:
            DeviceError: the link, the controller or the second watchdog failed; the robot was stopped as well as it can
                be.
        """
        self._check_connected()
        refusal = self.gate.refusal(dead_man)
        self._feed_guardian()
        sent = JointRates()
        if refusal or wanted.is_zero:
            if not self._still:
                self.stop()
            reason = refusal if not wanted.is_zero else ""
            return CommandSample(self._command_stamp(), wanted, sent, reason)
        with self._exchange():
            try:
                slack = self._joints_of(self.place.slack)
                allowed = clamp_rates(wanted, self._joints_ahead(), self.limits, self._ahead_s, slack)
                if self.gate.state == ARMED and not allowed.is_zero:
                    self._still = False
                    sent = self._send(allowed)
            except DeviceError:
                if self.gate.state == STOPPED:  # by another thread meanwhile
                    return CommandSample(self._command_stamp(), wanted, sent, f"stopped: {self.gate.reason}")
                raise
        if self.gate.state != ARMED:  # a stop that came first may have overtaken the command
            self._quietly(self._kill if self.gate.state == STOPPED else self._halt)
        return CommandSample(self._command_stamp(), wanted, sent, "" if allowed == wanted else "limit")

    def read(self, timeout_s: float = 0.5) -> RobotSample:
        """Ask the controller where it stands; while the place is lost, say where it was last certain.

        Raises:
            DeviceError: the link or the controller failed, or was reset; the robot was stopped as well as it can be.
        """
        self._check_connected()
        with self._exchange():
            known = self.place.is_known
            moving = self._read_axes(timeout_s)
            joints = self._joints_of(self.place.axes)
            if not self.place.is_known and (self.gate.state == ARMED or (known and self.gate.state != STOPPED)):
                self.emergency_stop(
                    self.place.why_lost
                )  # once: acknowledged, it waits for the operator's word on the place
        return RobotSample(self._stamp(), joints, moving, self.gate.state, self.place.is_known)

    @abstractmethod
    def set_light(self, level: float) -> float:
        """Dim the LED on the controller's own output to 0..1; returns the level sent."""

    @abstractmethod
    def _joints_of(self, axes: Array) -> Joints:
        """Joints of axes (3,) in the controller's unit, or of their slack."""

    @abstractmethod
    def _axes_of(self, joints: Joints) -> Array:
        """The inverse of `_joints_of`."""

    @abstractmethod
    def _joints_ahead(self) -> Joints:
        """Where everything sent so far will take the robot."""

    @abstractmethod
    def _send(self, rates: JointRates) -> JointRates:
        """Send motion that ends within ``horizon_s`` and return it as the controller will understand it."""

    @abstractmethod
    def _halt(self) -> None:
        """Tell the controller to drop what is queued; must not wait for an answer."""

    @abstractmethod
    def _kill(self) -> None:
        """Tell the controller to stop by its hardest means; must not wait for an answer or a lock."""

    @abstractmethod
    def _recover(self) -> None:
        """Make the controller ready again after `_kill` or an alarm; lose the place where it may have been reset."""

    @abstractmethod
    def _recount(self, axes: Array) -> None:
        """From now on the controller's present counts mean axes (3,)."""

    @abstractmethod
    def _read_axes(self, timeout_s: float) -> bool:
        """Take the controller's report to `place`; returns whether it moves."""

    def _may_pass_a_limit(self, step: Array, ahead: Array, opposed: NDArray[np.bool_], dropped: Array) -> bool:
        """Whether motion by (3,) axes would pass a limit if a reset dropped what it goes against; it must wait then.

        Who is sent back the way that he has never gone gets beyond where he came from. A limit is not passed by who
        stays behind; so only what goes against motion under way is asked about.

        Args:
            step: the motion.
            ahead: where (3,) all that was sent ends.
            opposed: (3,) which axes go against motion under way, see `recent_orders.is_against`.
            dropped: where (3,) those would be had that been dropped.
        """
        if not opposed.any():
            return False
        end = self._joints_of(np.where(opposed, dropped, ahead) + step)
        bent = math.hypot(end.bend_x_rad, end.bend_y_rad)
        return bent > self.limits.max_bend_rad or not 0 <= end.insertion_mm <= self.limits.max_insertion_mm

    def _stops(self) -> dict[int, bytes]:
        """File descriptors of the ports and what stops the robot there; empty where there are none to share."""
        return {}

    def _feed_guardian(self) -> None:
        """Tell the second watchdog that the program runs; a robot that it no longer watches is stopped."""
        guardian = self._guardian
        if guardian is None:
            return
        guardian.feed(self.gate.state == ARMED)
        if not guardian.is_alive and self.gate.state == ARMED:  # asked last: who dismisses it has disarmed before
            reason = "the second watchdog's process has ended or hangs; acknowledge, and arming starts another"
            self.emergency_stop(reason)
            raise DeviceError(f"The robot was stopped: {reason}.")

    def _dismiss_guardian(self) -> None:
        """End the second watchdog: its ports are closed, or others are opened."""
        guardian, self._guardian = self._guardian, None
        if guardian is not None:
            guardian.close()

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[None]:
        """Have the controller for oneself; any fault stops the robot before another thread may talk to the controller.

        An answer that is late comes among those to the next question, so none may be asked before all begins anew.
        """
        with self._lock:
            try:
                yield
            except Exception as error:  # whatever it was, nothing may move on
                self.emergency_stop(f"{type(error).__name__}: {error}")
                raise

    def _quietly(self, action: Callable[[], None]) -> None:
        """A link that is gone cannot be told to stop: the controller then runs out of queued motion."""
        with contextlib.suppress(DeviceError):
            action()

    def _watch(self) -> None:
        while not self._watch_end.wait(0.02):
            if self.gate.is_stale(self.watchdog_s):
                self.gate.disarm(f"watchdog: no command for {self.watchdog_s} s")
                self.stop()
