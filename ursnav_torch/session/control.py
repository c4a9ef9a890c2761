"""The cycle that turns the operator's hands into motion and light."""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from ursnav_torch.devices.base import (
    CommandSample,
    Gamepad,
    JointRates,
    Lamp,
    LightSample,
    Note,
    OperatorInput,
    RobotSample,
    Stamper,
)
from ursnav_torch.devices.robots.robot import Robot
from ursnav_torch.devices.robots.safety import STOPPED
from ursnav_torch.errors import DeviceError

#: A second acknowledgment this soon after the first is a trembling thumb, no word on where the robot stands.
CONFIRM_AFTER_S = 1.0


class Control:
    """One cycle of driving: hands in, motion and light out; call `step` 50 times a second.

    Args:
        robot: what moves; None drives nothing.
        gamepad: what the operator holds.
        light: what is dimmed, or None.
        light_step: what one press of the light's buttons changes.
        clock: seconds by which notes are stamped.
    """

    def __init__(
        self,
        robot: Robot | None,
        gamepad: Gamepad,
        light: Lamp | None = None,
        light_step: float = 0.1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.robot, self.gamepad, self.light, self.light_step = robot, gamepad, light, light_step
        self._level = 1.0
        self._last: OperatorInput | None = None
        self._note = Stamper(clock)
        self._cycle = 0
        self._acknowledged_s = 0.0

    def step(self) -> list[OperatorInput | CommandSample | LightSample | RobotSample | Note]:
        """Read the operator's hands once and act; every fifth time also ask the robot where it stands.

        Returns:
            What happened: the operator's input when it changed, the command as sent, and notes on faults; the robot
            stops itself at a fault and waits for the operator's acknowledgment.

        Raises:
            DeviceError: the input device failed; the robot was stopped and disarmed.
        """
        try:
            hands = self.gamepad.read()
        except Exception:
            if self.robot:
                self.robot.disarm()
            raise
        events: list[Any] = []
        if self._last is None or replace(hands, stamp=self._last.stamp) != self._last:
            events.append(hands)
        self._last = hands
        self._cycle += 1
        try:
            # The robot first, since a lamp's fault must not keep a stop from it; and one by one, since what was done
            # before a fault has happened.
            for event in itertools.chain(self._drive(hands), self._light(hands)):
                events.append(event)
        except DeviceError as error:
            events.append(Note(self._note(), "error", str(error)))
        except Exception as error:  # a driver's own mistake must neither end this cycle for good nor leave it moving
            if self.robot:
                self.robot.emergency_stop(f"{type(error).__name__}: {error}")
            events.append(Note(self._note(), "error", f"{type(error).__name__}: {error}"))
        return events

    def _drive(self, hands: OperatorInput) -> Iterator[Any]:
        if self.robot is None:
            return
        if hands.emergency_stop:
            self.robot.emergency_stop("operator")
        elif hands.acknowledge:
            yield from self._acknowledge(self.robot)
        elif hands.arm and not self.robot.arm():
            yield Note(self._note(), "warning", self.robot.why_not_armed)
        bend, push = self.robot.limits.max_bend_rate_rad_s, self.robot.limits.max_insertion_rate_mm_s
        wanted = JointRates(hands.bend_x * bend, hands.bend_y * bend, hands.insertion * push)
        yield self.robot.command(wanted, hands.dead_man)
        if self._cycle % 5 == 0:
            yield self.robot.read()

    def _acknowledge(self, robot: Robot) -> Iterator[Any]:
        """End a stop; where the robot's place was lost, the next acknowledgment confirms the last certain one.

        The light, which a controller puts out with the motors, comes back as it was.
        """
        now = time.monotonic()
        if robot.gate.state != STOPPED:
            if robot.place.is_known or now - self._acknowledged_s < CONFIRM_AFTER_S:
                return
            robot.confirm_place()
            yield Note(self._note(), "warning", "The robot's place was confirmed by the operator.")
            return
        robot.acknowledge()
        self._acknowledged_s = now
        if self.light is not None:
            yield self.light.set_level(self._level)
        if not robot.place.is_known:
            yield Note(self._note(), "warning", robot.why_not_armed)

    def _light(self, hands: OperatorInput) -> Iterator[LightSample]:
        if self.light is None or (hands.light_step == 0 and self._cycle > 1):
            return
        self._level = min(max(self._level + hands.light_step * self.light_step, 0.0), 1.0)
        yield self.light.set_level(self._level)
