"""A simulated NDI tracker: one wired tool, the commands that a host needs, binary poses."""

import time
from collections.abc import Callable

from ursnav_torch.devices.trackers.ndi import NdiTool, message, pack_bx

#: A sensor's position in mm and quaternion x y z w in the EM frame, or None while it is not seen.
SensorReading = tuple[tuple[float, float, float], tuple[float, float, float, float]] | None

VERSION = "Simulated tracker\nFreeze Tag: SIMULATED Rev 001\n"


class NdiUnit:
    """Answers host bytes like an Aurora with one tool; give `SimulatedPort` one to have it on a serial port.

    Args:
        sensor: called once a frame for the sensor's pose.
        rate_hz: frames a second; the Aurora's 40.
        clock: seconds, monotonic.

    Attributes:
        answering: False makes it deaf and dumb, as a hung unit is.
    """

    HANDLE = 0x0A

    def __init__(
        self,
        sensor: Callable[[], SensorReading],
        rate_hz: float = 40.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.answering = True
        self._sensor, self._rate_hz, self._clock = sensor, rate_hz, clock
        self._line = bytearray()
        self._frame = -1
        self._start_s = clock()
        self._pose = NdiTool(self.HANDLE, None, None, 0.0, 0)
        self._initialized = self._enabled = self._tracking = False

    def reset(self) -> bytes:
        """Start anew, as after a serial break or a power cut."""
        self._line.clear()
        self._initialized = self._enabled = self._tracking = False
        return message("RESET")

    def handle(self, data: bytes) -> bytes:
        """Bytes from the host in, the unit's answer out."""
        answer = b""
        if not self.answering:
            return answer
        for value in data:
            if value != ord("\r"):
                self._line.append(value)
                continue
            raw, self._line = bytes(self._line), bytearray()
            command = raw[:-4].decode("latin-1")
            answer += self._command(command) if message(command) == raw + b"\r" else message("ERROR04")
        return answer

    def _command(self, command: str) -> bytes:
        name, _, argument = command.partition(":")
        if name == "BX":
            return pack_bx([self._current()]) if self._tracking else message("ERROR0C")
        return message(self._text(name, argument))

    def _text(self, name: str, argument: str) -> str:
        handle = f"{self.HANDLE:02X}"
        if name == "PHSR":
            listed = {"02": not self._initialized, "03": self._initialized and not self._enabled}
            return f"01{handle}001" if listed.get(argument) else "00"
        if name in ("PINIT", "PENA", "PHF") and not argument.upper().startswith(handle):
            return "ERROR0A"
        if name == "VER":
            return VERSION
        if name == "INIT":
            self._initialized = self._enabled = self._tracking = False
        elif name == "PINIT":
            self._initialized = True
        elif name == "PENA":
            self._enabled = self._initialized
        elif name in ("TSTART", "TSTOP"):
            self._tracking = name == "TSTART"
        elif name not in ("COMM", "PHF"):
            return "ERROR01"
        return "OKAY"

    def _current(self) -> NdiTool:
        """The pose of the present frame; a frame keeps its pose however often it is asked for."""
        frame = int((self._clock() - self._start_s) * self._rate_hz)
        if frame != self._frame:
            self._frame = frame
            reading = self._sensor() if self._enabled else None
            if reading is None:
                self._pose = NdiTool(self.HANDLE, None, None, 0.0, frame)
            else:
                position, (x, y, z, w) = reading
                self._pose = NdiTool(self.HANDLE, (w, x, y, z), position, 0.1, frame)
        return self._pose
