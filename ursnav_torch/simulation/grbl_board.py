"""A simulated GRBL 1.1 board: the subset of its language that a jogging robot needs, with true ramps.

Written from GRBL's published interface; it plans straight moves with a look-ahead, accelerates and brakes
within its settings, and forgets nothing when its host dies.
"""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ursnav_torch.geometry import Array

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
PLANNER_BLOCKS, RX_BYTES = 15, 128
TICK_S = 0.002
SETTINGS = {
    0: 10, 1: 255, 2: 0, 3: 0, 10: 1, 11: 0.010, 13: 0, 20: 0, 21: 0, 22: 0, 30: 1000, 31: 0, 32: 0,
    100: 528, 101: 528, 102: 400, 110: 600, 111: 600, 112: 1200, 120: 500, 121: 500, 122: 500,
    130: 50, 131: 50, 132: 200,
}  # fmt: skip


@dataclass(slots=True)
class Block:
    """A straight move: unit direction (3,), what is left of it in mm, speed in mm/s, acceleration in mm/s^2."""

    direction: Array
    left_mm: float
    speed: float
    acceleration: float


class GrblBoard:
    """Answers host bytes like a GRBL 1.1 board; give `SimulatedPort` one to have it on a serial port.

    Attributes:
        settings: the ``$`` settings by number.
        spindle: speed word S of the LED, 0 when off.
        feed: the parser's feed rate F, which jogs leave alone and every reset puts to 0.
        answering: False makes it deaf and dumb, as a hung board is.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.settings: dict[int, float] = dict(SETTINGS)
        self.spindle, self.feed = 0, 0.0
        self.answering = True
        self._lock = threading.RLock()
        self._clock, self._now = clock, clock()
        self._position = np.zeros(3)
        self._blocks: deque[Block] = deque()
        self._speed = 0.0
        self._state = "Idle"
        self._cancelling = False
        self._line = bytearray()
        self._waiting: deque[str] = deque()
        self._reports = 0

    @property
    def moving(self) -> bool:
        """True while an axis moves."""
        self.advance()
        return bool(self._blocks)

    @property
    def light(self) -> float:
        """The LED's level from 0 to 1."""
        return self.spindle / self.settings[30]

    def axes_mm(self) -> Array:
        """Where the axes are now, (3,) mm."""
        with self._lock:
            self.advance()
            return self._position.copy()

    def power_cycle(self) -> bytes:
        """Lose power and come back: everything but the place of the motors is forgotten."""
        with self._lock:
            self.advance()
            self._begin_anew()
            self._position, self._state = np.zeros(3), "Idle"
            return BANNER

    def handle(self, data: bytes) -> bytes:
        """Bytes from the host in, the board's answer out."""
        with self._lock:
            self.advance()
            if not self.answering:
                return b""
            answer = b"".join(self._byte(value) for value in data)
            return answer + self._run_waiting()

    def advance(self) -> None:
        """Let the motors run until now."""
        with self._lock:
            now = self._clock()
            while self._blocks and self._now < now:
                self._tick(min(TICK_S, now - self._now))
                self._now = min(now, self._now + TICK_S)
            self._now = now
            if not self._blocks:
                self._come_to_rest()

    def _come_to_rest(self) -> None:
        self._speed, self._cancelling = 0.0, False
        if self._state == "Jog":
            self._state = "Idle"

    def _tick(self, dt: float) -> None:
        block = self._blocks[0]
        goal = 0.0 if self._cancelling else self._allowed_speed()
        change = block.acceleration * dt
        self._speed = min(max(goal, self._speed - change), self._speed + change)
        if self._cancelling and self._speed <= 0:
            self._blocks.clear()
            return
        way = max(self._speed, 0.5 * change) * dt
        while self._blocks and way > 0:
            block = self._blocks[0]
            part = min(way, block.left_mm)
            self._position = self._position + part * block.direction
            block.left_mm, way = block.left_mm - part, way - part
            if block.left_mm <= 1e-9:
                self._blocks.popleft()

    def _allowed_speed(self) -> float:
        """The fastest speed now from which every block ahead keeps its own and corners are met at rest."""
        allowed, way = self._blocks[0].speed, 0.0
        for n, block in enumerate(self._blocks):
            after = self._blocks[n + 1] if n + 1 < len(self._blocks) else None
            way += block.left_mm
            corner = after is None or block.direction @ after.direction < 0.95
            exit_speed = 0.0 if corner or after is None else after.speed
            allowed = min(allowed, float(np.sqrt(exit_speed**2 + 2 * block.acceleration * way)))
            if corner:
                break
        return allowed

    def _byte(self, value: int) -> bytes:
        """One byte: real-time commands are served at once, the rest builds lines."""
        if value == 0x18:
            return self._reset()
        if value == ord("?"):
            return self._report()
        if value in (0x85, ord("!")):
            self._cancelling = bool(self._blocks)
        elif value in b"\r\n":
            self._waiting.append(self._line.decode("ascii", "replace"))
            self._line.clear()
        elif value < 0x80 and value != ord("~") and len(self._line) < RX_BYTES:
            self._line.append(value)
        return b""

    def _reset(self) -> bytes:
        alarm = b"ALARM:3\r\n" if self._blocks else b""
        locked = bool(alarm) or self._state == "Alarm"
        self._begin_anew()
        self._state = "Alarm" if locked else "Idle"
        return alarm + BANNER + (b"[MSG:'$H'|'$X' to unlock]\r\n" if locked else b"")

    def _begin_anew(self) -> None:
        """What a soft reset and a power-on have in common: buffers, parser and outputs as they are at first."""
        self._blocks.clear()
        self._waiting.clear()
        self._line.clear()
        self.spindle, self.feed, self._cancelling, self._speed, self._reports = 0, 0.0, False, 0.0, 0

    def _report(self) -> bytes:
        position = ",".join(f"{v:.3f}" for v in self._position)
        extra = "|WCO:0.000,0.000,0.000" if self._reports % 30 == 0 else ""
        self._reports += 1
        feed = round(self._speed * 60)
        return f"<{self._state}|MPos:{position}|FS:{feed},{self.spindle}{extra}>\r\n".encode()

    def _run_waiting(self) -> bytes:
        """Execute complete lines, as far as a braking jog and the planner's room allow."""
        answer = b""
        while self._waiting and not self._cancelling and len(self._blocks) < PLANNER_BLOCKS:
            answer += self._execute(self._waiting.popleft().replace(" ", "").upper())
        return answer

    def _execute(self, line: str) -> bytes:
        if line == "":
            return b"ok\r\n"
        if line.startswith("$J="):
            return self._jog(line[3:])
        if line == "$$":
            return b"".join(f"${n}={v:g}\r\n".encode() for n, v in self.settings.items()) + b"ok\r\n"
        if line == "$G":
            spindle = "M3" if self.spindle else "M5"
            return f"[GC:G0 G54 G17 G21 G90 G94 {spindle} M9 T0 F{self.feed:g} S{self.spindle}]\r\nok\r\n".encode()
        if line == "$X":
            message = b"[MSG:Caution: Unlocked]\r\n" if self._state == "Alarm" else b""
            self._state = "Idle" if self._state == "Alarm" else self._state
            return message + b"ok\r\n"
        if line.startswith("$"):
            return b"error:3\r\n"
        return b"error:9\r\n" if self._state != "Idle" else self._block(line)

    def _block(self, line: str) -> bytes:
        """A G-code block: the spindle's commands and a feed rate."""
        if line.startswith("F") and line[1:].isdigit():
            self.feed = float(line[1:])
        elif line == "M5":
            self.spindle = 0
        elif line.startswith("M3S") and line[3:].isdigit():
            self.spindle = min(int(line[3:]), int(self.settings[30]))
        else:
            return b"error:20\r\n"
        return b"ok\r\n"

    def _jog(self, words: str) -> bytes:
        if self._state not in ("Idle", "Jog"):
            return b"error:9\r\n"
        if not words.startswith("G21G91"):
            return b"error:16\r\n"
        move, feed = np.zeros(3), 0.0
        try:
            for letter, value in _words(words[6:]):
                if letter == "F":
                    feed = value / 60
                else:
                    move["XYZ".index(letter)] = value
        except ValueError:
            return b"error:2\r\n"
        length = float(np.linalg.norm(move))
        if feed <= 0:
            return b"error:22\r\n"
        if length == 0:
            return b"error:26\r\n"
        self._plan(move / length, length, feed)
        return b"ok\r\n"

    def _plan(self, direction: Array, length: float, feed: float) -> None:
        share = np.maximum(np.abs(direction), 1e-9)
        fastest = float(min(self.settings[110 + n] / 60 / share[n] for n in range(3)))
        acceleration = float(min(self.settings[120 + n] / share[n] for n in range(3)))
        self._blocks.append(Block(direction, length, min(feed, fastest), acceleration))
        self._state = "Jog"


def _words(text: str) -> list[tuple[str, float]]:
    """``X1.5F60`` as letters and values; raises ValueError where it cannot be read."""
    starts = [n for n, c in enumerate(text) if c.isalpha()] + [len(text)]
    return [(text[a], float(text[a + 1 : b])) for a, b in itertools.pairwise(starts)]
