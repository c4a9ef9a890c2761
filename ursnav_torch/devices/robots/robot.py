"""The robot's contract and what every robot has in common: gate, limits, watchdog, stop on any fault."""

import contextlib
import threading
from abc import abstractmethod
from collections.abc import Callable

from ursnav_torch.devices.base import CommandSample, Device, JointRates, Joints, RobotSample, Stamper
from ursnav_torch.devices.robots.safety import ARMED, STOPPED, Limits, SafetyGate, clamp_rates
from ursnav_torch.errors import DeviceError, InputError

#: No controller is ever given motion for longer than this, so that a dead host means a still robot.
MAX_QUEUED_S = 0.5


class Robot(Device):
    """A robot driven by rates, each command good for ``horizon_s`` at most.

    It starts disarmed. Every fault of the link, an alarm of the controller and `emergency_stop` stop it until
    `acknowledge` and `arm`. If it is armed and not commanded for ``watchdog_s``, it is stopped and disarmed.

    Raises:
        InputError: ``horizon_s`` is not between 0 and 0.5, or ``watchdog_s`` not above it.
    """

    def __init__(self, limits: Limits, horizon_s: float, watchdog_s: float) -> None:
        super().__init__()
        if not 0 < horizon_s < MAX_QUEUED_S:
            raise InputError(f"horizon_s must lie between 0 and {MAX_QUEUED_S} s, got {horizon_s}.")
        if not horizon_s < watchdog_s <= MAX_QUEUED_S:
            raise InputError(f"watchdog_s must lie between horizon_s and {MAX_QUEUED_S} s, got {watchdog_s}.")
        self.limits, self.horizon_s, self.watchdog_s = limits, horizon_s, watchdog_s
        self.gate = SafetyGate()
        self._command_stamp = Stamper()
        self._lock = threading.RLock()
        self._still = True
        self._watch_end = threading.Event()

    def connect(self) -> None:
        """Open the link and start the watchdog; raises as `Device.connect` does."""
        if self._connected:
            return
        super().connect()
        self._watch_end.clear()
        threading.Thread(target=self._watch, name="robot-watchdog", daemon=True).start()

    def disconnect(self) -> None:
        """Stop, disarm and close."""
        self._watch_end.set()
        self.gate.disarm("disconnected")
        super().disconnect()

    def arm(self) -> bool:
        """Allow motion; False after a stop that was not acknowledged."""
        self._check_connected()
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
        """After a stop: make the controller ready again and go back to disarmed.

        Raises:
            DeviceError: the controller does not come back; the robot stays stopped.
        """
        self._check_connected()
        if self.gate.state != STOPPED:
            return
        with self._lock:
            self._recover()
        self.gate.acknowledge()

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
            DeviceError: the link or the controller failed; the robot was stopped as well as it can be.
        """
        self._check_connected()
        refusal = self.gate.refusal(dead_man)
        sent = JointRates()
        if refusal or wanted.is_zero:
            if not self._still:
                self.stop()
            reason = refusal if not wanted.is_zero else ""
            return CommandSample(self._command_stamp(), wanted, sent, reason)
        try:
            with self._lock:
                allowed = clamp_rates(wanted, self._joints_ahead(), self.limits, self.horizon_s)
                if self.gate.state == ARMED and not allowed.is_zero:
                    self._still = False
                    sent = self._send(allowed)
        except DeviceError as error:
            if self.gate.state == STOPPED:  # stopped by another thread while the command was under way
                return CommandSample(self._command_stamp(), wanted, sent, f"stopped: {self.gate.reason}")
            self.emergency_stop(f"{type(error).__name__}: {error}")
            raise
        if self.gate.state != ARMED:  # a stop that came first may have overtaken the command
            self._quietly(self._kill if self.gate.state == STOPPED else self._halt)
        return CommandSample(self._command_stamp(), wanted, sent, "" if allowed == wanted else "limit")

    def read(self, timeout_s: float = 0.5) -> RobotSample:
        """Ask the controller where it stands.

        Raises:
            DeviceError: the link or the controller failed; the robot was stopped as well as it can be.
        """
        self._check_connected()
        try:
            with self._lock:
                joints, moving = self._read_joints(timeout_s)
        except DeviceError as error:
            self.emergency_stop(f"{type(error).__name__}: {error}")
            raise
        return RobotSample(self._stamp(), joints, moving, self.gate.state)

    @abstractmethod
    def set_light(self, level: float) -> float:
        """Dim the LED on the controller's own output to 0..1; returns the level sent."""

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
        """Make the controller ready again after `_kill` or an alarm."""

    @abstractmethod
    def _read_joints(self, timeout_s: float) -> tuple[Joints, bool]: ...

    def _quietly(self, action: Callable[[], None]) -> None:
        """A link that is gone cannot be told to stop: the controller then runs out of queued motion."""
        with contextlib.suppress(DeviceError):
            action()

    def _watch(self) -> None:
        while not self._watch_end.wait(0.02):
            if self.gate.is_stale(self.watchdog_s):
                self.gate.disarm(f"watchdog: no command for {self.watchdog_s} s")
                self.stop()
