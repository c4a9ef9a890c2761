"""A robot on a simulated board in simulated time, on a machine that stalls where it is told to.

Real drivers talk to real simulated boards, but no thread runs and no second passes: whatever the driver writes is heard
at once, unless a stall comes between. So a race of a busy machine is a schedule that a test can write down.
"""

import contextlib
from collections.abc import Iterator

import numpy as np
import pytest
from clocks import Clock, runs_on

from benchmarks.safety.bench import STEPS_PER_MM
from ursnav_torch.devices import GrblRobot, JointRates, Limits, Robot, RosserialRobot
from ursnav_torch.devices.robots.safety import STOPPED, SafetyGate
from ursnav_torch.errors import DeviceError
from ursnav_torch.geometry import Array
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.rosserial_board import RosserialBoard

DEVICES = "ursnav_torch.devices"
#: Board and driver wait for each other by steps of this long.
TICK_S = 0.002
ROUNDING_MM = 0.02


class SlowLine:
    """What pyserial gives: a port with a simulated board behind it, on a clock.

    Attributes:
        stalls: seconds that the machine is busy with other things before it does its n-th deed on the line.
        deeds: what was done, in order: ``deliver`` bytes to the board, ``written`` when they are, ``read`` an answer.
        robot: the robot on it; None while it is connected.
        outside: when the true axes were not within the bounds in which the robot held them to be, and by how much.
    """

    def __init__(self, kind: str, clock: Clock) -> None:
        self.clock, self.grbl = clock, kind == "grbl"
        self.board: GrblBoard | RosserialBoard = (GrblBoard if self.grbl else RosserialBoard)(clock.monotonic)
        self.stalls: dict[int, float] = {}
        self.deeds: list[str] = []
        self.robot: Robot | None = None
        self.outside: list[str] = []
        self._incoming = bytearray()
        self._forgotten = np.zeros(3)

    @property
    def in_waiting(self) -> int:
        """How many bytes have come."""
        self._hear(b"")
        return len(self._incoming)

    def write(self, data: bytes) -> None:
        """Bytes to the board, after the stall that is due, if one is."""
        self._do("deliver")
        self._hear(data)
        self._do("written")

    def read(self, count: int) -> bytes:
        """Bytes of the board; where there are none, a little time passes instead."""
        if not self.in_waiting:
            self.sleep(TICK_S)
            return b""
        data = bytes(self._incoming[:count])
        del self._incoming[:count]
        self._do("read")
        return data

    def close(self) -> None:
        """Nothing: the board stays plugged in."""

    def reset(self, heard: bool) -> None:
        """The board starts anew and counts from zero."""
        self._forgotten = self.true_axes()
        greeting = self.board.power_cycle() if isinstance(self.board, GrblBoard) else self.board.restart()
        self._incoming += greeting if heard else b""

    def true_axes(self) -> Array:
        """Where the axes truly stand, (3,) in the controller's unit."""
        board = self.board
        return self._forgotten + (board.axes_mm() if isinstance(board, GrblBoard) else board.steps())

    def sleep(self, seconds: float) -> None:
        """Time passes."""
        end = self.clock.now_s + seconds
        while self.clock.now_s < end - 1e-9:
            self.clock.now_s = min(end, self.clock.now_s + TICK_S)
            self._hear(b"")
        self.look("later")

    def look(self, deed: str) -> None:
        """Note where the axes are against where the robot holds it possible that they are."""
        if self.robot is None:
            return
        place, true = self.robot.place, self.true_axes()
        off = np.maximum(place._low - true, true - place._high) - place.slack
        mm = float(off[2]) / (1.0 if self.grbl else STEPS_PER_MM)
        if mm > ROUNDING_MM:
            self.outside.append(f"{len(self.deeds)} {deed} at {self.clock.now_s:.3f}: {mm:.2f} mm outside")

    def drive(self, rate_mm_s: float, seconds: float) -> None:
        """As a session does: 50 commands a second, every fifth with a reading, until something is wrong."""
        end, cycle = self.clock.now_s + seconds, 0
        while self.clock.now_s < end:
            cycle += 1
            try:
                self.robot.command(JointRates(insertion_mm_s=rate_mm_s), True)
                self.look("commanded")
                if cycle % 5 == 0:
                    self.robot.read()
            except DeviceError:
                self.look("failed")
                return
            self.look("read")
            self.sleep(0.02)

    def recover(self) -> tuple[float, float, float]:
        """Stop, acknowledge, and confirm the place if it is unknown: what is said, what is true, the slack, in mm."""
        robot = self.robot
        robot.emergency_stop("operator")
        for _ in range(5):
            self.sleep(0.3)
            with contextlib.suppress(DeviceError):
                robot.acknowledge()
            if robot.gate.state != STOPPED:
                break
        if not robot.place.is_known:
            robot.confirm_place()
        said, slack = robot.read().joints.insertion_mm, robot._joints_of(robot.place.slack).insertion_mm
        return said, robot._joints_of(self.true_axes()).insertion_mm, slack

    def _do(self, deed: str) -> None:
        self.deeds.append(deed)
        if stall := self.stalls.get(len(self.deeds)):
            self.sleep(stall)
        self.look(deed)

    def _hear(self, data: bytes) -> None:
        self._incoming += self.board.handle(data)


@contextlib.contextmanager
def slow_line(kind: str, limits: Limits, monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowLine]:
    """Yield the line with a connected robot on it."""
    clock = Clock()
    line = SlowLine(kind, clock)
    clock.sleep = line.sleep
    with monkeypatch.context() as patch:
        for module in ("robots.grbl", "robots.rosserial", "robots.rosserial_packets", "serial_link"):
            runs_on(clock, f"{DEVICES}.{module}", patch)
        patch.setattr(f"{DEVICES}.serial_link.serial.serial_for_url", lambda *_, **__: line)
        robot = GrblRobot("line", limits=limits) if kind == "grbl" else RosserialRobot(["line"], limits=limits)
        robot.gate = SafetyGate(lambda: 0.0)  # its watchdog runs by the machine's clock
        with robot:
            line.robot = robot
            yield line
