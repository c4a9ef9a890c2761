"""A robot on a simulated board whose true place is known, whatever the board counts, and what can befall its board."""

import os
import tempfile
import time
from pathlib import Path
from typing import Any, Self

from ursnav_torch.devices import GrblRobot, JointRates, Limits, Robot, RosserialRobot
from ursnav_torch.errors import DeviceError
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.port import SimulatedPort
from ursnav_torch.simulation.rosserial_board import RosserialBoard

KINDS = ("grbl", "rosserial")
#: Steps of the simulated Arduino's slider, a mm.
STEPS_PER_MM = 400


class Bench:
    """A board on a port, its robot, and where the slider truly stands.

    Args:
        kind: ``grbl`` or ``rosserial``.
        limits: of the robot.

    Attributes:
        robot: connected, not armed.
        farthest_mm: the least and the largest true place so far.
    """

    def __init__(self, kind: str, limits: Limits) -> None:
        self.grbl = kind == "grbl"
        self.board: GrblBoard | RosserialBoard = GrblBoard() if self.grbl else RosserialBoard()
        self._folder = tempfile.TemporaryDirectory()
        self._name = Path(self._folder.name) / "board"  # as udev gives a board the same name wherever it is plugged in
        self._forgotten_mm = 0.0
        self.port = self._plugged()
        self.robot: Robot = (
            GrblRobot(self.path, limits=limits) if self.grbl else RosserialRobot([self.path], limits=limits)
        )
        self.robot.connect()
        self.farthest_mm = (0.0, 0.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.robot.disconnect()
        self.port.close()
        self._folder.cleanup()

    @property
    def path(self) -> str:
        """The port's name, which stays when the board is plugged in anew."""
        return str(self._name)

    def true_mm(self) -> float:
        """How far in the slider truly stands."""
        return self._forgotten_mm + self._counted_mm()

    def slack_mm(self) -> float:
        """How far off the robot says that it may be."""
        return self.robot._joints_of(self.robot.place.slack).insertion_mm

    def reset(self, heard: bool = True) -> None:
        """The board starts anew, in mid-motion or not; its greeting may be lost on the line."""
        greeting = self._restarted()
        if heard:
            os.write(self.port._master, greeting)

    def cut_power(self, seconds: float) -> None:
        """The board is without power for a time, silent, and then counts from zero."""
        self.board.answering = False
        self._restarted()
        time.sleep(seconds)
        self.board.answering = True

    def unplug(self, seconds: float, keeps_power: bool) -> None:
        """The plug is out for a time; a board that takes its power from it counts from zero then."""
        self.port.unplug()
        if not keeps_power:
            self._restarted()
        time.sleep(seconds)
        self.port = self._plugged()

    def drive(self, rate_mm_s: float, seconds: float) -> None:
        """Drive as a session does, 50 commands a second, until the time is over or something is wrong."""
        end, cycle = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            cycle += 1
            try:
                self.robot.command(JointRates(insertion_mm_s=rate_mm_s), True)
                if cycle % 5 == 0:
                    self.robot.read()
            except DeviceError:
                return
            self.look()
            time.sleep(0.02)

    def look(self) -> None:
        """Keep the farthest true places."""
        at = self.true_mm()
        self.farthest_mm = min(self.farthest_mm[0], at), max(self.farthest_mm[1], at)

    def come_to_rest(self, patience_s: float = 5.0) -> bool:
        """Wait until the board stands still; whether it does."""
        end = time.monotonic() + patience_s
        while self.board.moving and time.monotonic() < end:
            time.sleep(0.005)
        self.look()
        return not self.board.moving

    def _plugged(self) -> SimulatedPort:
        port = SimulatedPort(self.board, period_s=0.002)
        draft = self._name.with_suffix(".new")
        draft.symlink_to(port.path)
        draft.replace(self._name)
        return port

    def _counted_mm(self) -> float:
        board: Any = self.board
        return float(board.axes_mm()[2] if self.grbl else board.steps()[2] / STEPS_PER_MM)

    def _restarted(self) -> bytes:
        """What the board says when it starts anew; it stands where it stood, and counts from zero."""
        board: Any = self.board
        with board._lock:
            self._forgotten_mm = self.true_mm()
            greeting: bytes = board.power_cycle() if self.grbl else board.restart()
            return greeting
