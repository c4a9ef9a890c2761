"""The operator's hands when they are on a page: a gamepad beside the real one, with a dead man's switch of its own."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from ursnav_torch.devices import Gamepad, OperatorInput, Robot, Stamper
from ursnav_torch.devices.robots.safety import DISARMED
from ursnav_torch.simulation import TwinPilot

#: One press of a button on the page moves for this long; the page repeats it while it is held.
HOLD_S = 0.35
#: Ways to drive: stick deflections of bend about x and y, and insertion; named as the picture moves.
MOVES = {
    "forward": (0.0, 0.0, 1.0),
    "back": (0.0, 0.0, -1.0),
    "up": (1.0, 0.0, 0.0),
    "down": (-1.0, 0.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "right": (0.0, 1.0, 0.0),
}
#: Holds the dead-man button and moves no stick: where autonomy steers, it goes on for as long.
HOLD = "hold"


class Console(Gamepad):
    """Stands in front of the rig's own input device, if there is one, and adds what is pressed on a page.

    Anybody may stop from a page, and acknowledge the stop. Only a simulated robot can be armed and driven from one:
    ``may_drive``. A press moves for `HOLD_S`, so a page that is closed or hangs moves nothing.

    Args:
        hands: the input device, or None.
        robot: stopped at once, without waiting for the next cycle; or None.
        may_drive: whether the page may arm and drive.
        stay: whether a pilot that has finished leaves the scope to the page instead of ending the session.
        clock: seconds by which its input is stamped.
    """

    def __init__(
        self,
        hands: Gamepad | None,
        robot: Robot | None = None,
        may_drive: bool = False,
        stay: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._stamp = Stamper(clock)
        self.hands, self.may_drive, self._robot = hands, may_drive, robot
        self._pilot = isinstance(hands, TwinPilot)
        self.by_hand = hands is None
        self._stay = stay and self._pilot
        self._lock = threading.Lock()
        self._move, self._until_s = (0.0, 0.0, 0.0), 0.0
        self._presses: set[str] = set()
        self._light_steps = 0

    @property
    def has_robot(self) -> bool:
        """Whether there is anything to stop."""
        return self._robot is not None

    @property
    def has_pilot(self) -> bool:
        """Whether a pilot can fly."""
        return self._pilot

    def drive(self, move: str, hold_s: float = HOLD_S) -> None:
        """Take over and move one of `MOVES` for a moment, or `HOLD`; nothing where the page may not drive."""
        if not self.may_drive or move not in (*MOVES, HOLD):
            return
        with self._lock:
            self.by_hand = True
            self._move, self._until_s = MOVES.get(move, (0.0, 0.0, 0.0)), time.monotonic() + min(hold_s, HOLD_S)

    def release(self) -> None:
        """Stand still."""
        with self._lock:
            self._until_s = 0.0

    def give_to_pilot(self, flying: bool) -> None:
        """Let the pilot fly on, or take over from it."""
        if self._pilot and self.may_drive:
            with self._lock:
                self.by_hand, self._until_s = not flying, 0.0

    def arm(self) -> None:
        """Allow motion, where the page may."""
        if self.may_drive:
            self._press("arm")

    def brighten(self, steps: int) -> None:
        """Brighten the light by steps, or dim it, where the page may; a controller's reset puts its light out."""
        if self.may_drive:
            with self._lock:
                self._light_steps += steps

    def emergency_stop(self) -> None:
        """Stop everything now; a pilot does not fly on by itself."""
        self.release()
        self.by_hand = self.by_hand or self._pilot
        self._press("emergency_stop")
        if self._robot is not None:
            self._robot.emergency_stop("stopped from the page")

    def acknowledge(self) -> None:
        """Take note of a stop; motion needs arming again."""
        self._press("acknowledge")

    def read(self) -> OperatorInput:
        """The page's hands over those of the device behind it; a stop pressed on either counts."""
        self._check_connected()
        with self._lock:
            presses, self._presses = self._presses, set()
            light_steps, self._light_steps = self._light_steps, 0
            move = self._move if time.monotonic() < self._until_s else None
            waiting = self._pilot and self.by_hand
        if self._pilot and self.may_drive and not waiting and self._robot and self._robot.gate.state == DISARMED:
            presses.add("arm")  # a busy machine's watchdog disarms, and a pilot has no hand for that button
        own = OperatorInput(self._stamp()) if self.hands is None or waiting else self.hands.read()
        if own.quit and self._stay:
            self.by_hand = True
            own = OperatorInput(own.stamp)
        if move is not None:
            own = replace(own, bend_x=move[0], bend_y=move[1], insertion=move[2], dead_man=True)
        return replace(
            own,
            light_step=own.light_step + light_steps,
            arm=own.arm or "arm" in presses,
            acknowledge=own.acknowledge or "acknowledge" in presses,
            emergency_stop=own.emergency_stop or "emergency_stop" in presses,
        )

    def _press(self, button: str) -> None:
        with self._lock:
            self._presses.add(button)

    def _open(self) -> None:
        if self.hands is not None:
            self.hands.connect()

    def _close(self) -> None:
        if self.hands is not None:
            self.hands.disconnect()
