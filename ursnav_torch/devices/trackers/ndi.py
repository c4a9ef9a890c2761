"""NDI Aurora and Polaris trackers over a serial port, spoken directly.

The commands are ``CMD:arguments``, a CRC-16 (polynomial 0xA001 reflected, start 0) as four hex digits and a
carriage return; poses come in the binary answer to ``BX``. Written from NDI's interface as ndicapi uses it.
ndicapi itself holds Python's lock while it waits, up to seven seconds for a dead unit, in which no other
thread runs, the robot's watchdog included; for its Polaris and Vega support see `surgery_ndi`.
"""

import math
import re
import struct
import time
from dataclasses import dataclass

from fastcrc import crc16

from ursnav_torch.devices.base import EmTracker, TrackerSample
from ursnav_torch.devices.serial_link import SerialLink
from ursnav_torch.devices.wire import SensorPose, Tool
from ursnav_torch.errors import DeviceError, DeviceProtocolError, DeviceTimeoutError, InputError

BX_START = b"\xc4\xa5"
VALID, MISSING, DISABLED = 1, 2, 4
INIT_PAUSE_S, RESET_S, INIT_TRY_S = 0.1, 5.0, 0.5
ERRORS = {
    "01": "invalid command",
    "04": "wrong CRC of the command",
    "0A": "invalid port handle",
    "0C": "invalid in the current mode",
    "13": "the tool cannot be initialized; has it an SROM?",
}


def message(text: str) -> bytes:
    """A command or text answer with its CRC and carriage return: ``INIT:`` becomes ``INIT:E3A5\\r``."""
    raw = text.encode("latin-1", "replace")
    return raw + f"{crc16.arc(raw):04X}\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class NdiTool:
    """One tool in a BX answer; quaternion in NDI's order w x y z, None unless the tool is seen."""

    handle: int
    quaternion_wxyz: tuple[float, float, float, float] | None
    position_mm: tuple[float, float, float] | None
    error_mm: float
    frame: int


def pack_bx(tools: list[NdiTool], system_status: int = 0) -> bytes:
    """The answer to ``BX:0801`` that reports ``tools``."""
    body = bytes([len(tools)])
    for tool in tools:
        if tool.quaternion_wxyz is None or tool.position_mm is None:
            body += struct.pack("<BBII", tool.handle, MISSING, 0x31, tool.frame)
        else:
            pose = (*tool.quaternion_wxyz, *tool.position_mm, tool.error_mm)
            body += struct.pack("<BB8fII", tool.handle, VALID, *pose, 0x31, tool.frame)
    body += struct.pack("<H", system_status)
    head = BX_START + struct.pack("<H", len(body))
    return head + struct.pack("<H", crc16.arc(head)) + body + struct.pack("<H", crc16.arc(body))


def unpack_bx_body(body: bytes) -> list[NdiTool]:
    """The tools in the body of a BX answer, without its header and CRC.

    Raises:
        DeviceProtocolError: the body does not have the length its content asks for.
    """
    tools, at = [], 1
    try:
        for _ in range(body[0]):
            handle, status = struct.unpack_from("<BB", body, at)
            at += 2
            pose: tuple[float, ...] = ()
            if status == VALID:
                pose = struct.unpack_from("<8f", body, at)
                at += 32
            frame = 0
            if status != DISABLED:
                _, frame = struct.unpack_from("<II", body, at)
                at += 8
            q, t = (pose[:4], pose[4:7]) if pose else (None, None)
            tools.append(NdiTool(handle, q, t, pose[7] if pose else math.nan, frame))  # type: ignore[arg-type]
    except (struct.error, IndexError) as error:
        raise DeviceProtocolError(f"NDI: BX answer is cut short ({error}).") from error
    if at + 2 != len(body):
        raise DeviceProtocolError(f"NDI: BX answer has {len(body)} bytes, its content asks for {at + 2}.")
    return tools


class NdiTracker(EmTracker):
    """A tool of an NDI tracker, polled over a serial port.

    Args:
        port: device path or pyserial URL.
        tool: which of the plugged-in tools, counted from 0.
        dof: 5 for a sensor that does not know its roll (thesis §4.3.2), 6 otherwise.
        deadline_s: how long the unit may take for a text command; poses that have not come by then are lost.
        rate_hz: the unit's own rate; a sample is a new frame number.

    Raises:
        InputError: ``dof`` is neither 5 nor 6.
    """

    def __init__(self, port: str, tool: int = 0, dof: int = 5, deadline_s: float = 2.0, rate_hz: float = 40.0) -> None:
        super().__init__()
        if dof not in (5, 6):
            raise InputError(f"dof must be 5 or 6, got {dof}.")
        self.port, self.tool, self.dof, self.deadline_s, self.rate_hz = port, tool, dof, deadline_s, rate_hz
        self._link: SerialLink | None = None
        self._handle = 0
        self._frame, self._next_s = -1, 0.0
        self._answer = b""  # what has come of it
        self._late_until_s = -math.inf  # an answer that nobody waited for may come until then

    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the tool's next frame; raises as `EmTracker.read` does, and DeviceProtocolError."""
        self._check_connected()
        deadline = time.monotonic() + timeout_s
        time.sleep(max(0.0, min(self._next_s, deadline) - time.monotonic()))
        while True:
            pose = self._poll(deadline)
            if pose.frame != self._frame:
                self._frame, self._next_s = pose.frame, time.monotonic() + 0.7 / self.rate_hz
                return self._sample(pose)
            if time.monotonic() > deadline:
                raise DeviceTimeoutError(f"{self.port}: the tracker repeats frame {pose.frame}; is it tracking?")
            time.sleep(0.1 / self.rate_hz)

    def _poll(self, deadline: float) -> NdiTool:
        """Ask once for all poses and pick ours."""
        self._drop_late(deadline)
        asked_s = time.monotonic()
        try:
            self._port().write(message("BX:0801"))
            body = self._read_bx(deadline)
        except DeviceTimeoutError:
            self._late_until_s = asked_s + self.deadline_s
            raise
        for pose in unpack_bx_body(body):
            if pose.handle == self._handle:
                return pose
        raise DeviceProtocolError(f"{self.port}: tool handle {self._handle:02X} is gone; was it unplugged?")

    def _drop_late(self, deadline: float) -> None:
        """Wait out an answer that came too late for its question: the next question's would be taken for now's.

        Raises:
            DeviceTimeoutError: it may still come.
        """
        late_until_s, self._late_until_s = self._late_until_s, -math.inf
        try:
            if time.monotonic() < late_until_s:
                self._read_bx(min(deadline, late_until_s))
        except DeviceTimeoutError:
            if time.monotonic() < late_until_s:
                self._late_until_s = late_until_s
                raise
        self._answer = b""
        self._port().discard_input()

    def _read_bx(self, deadline: float) -> bytes:
        start = self._read_to(2, deadline)
        if start != BX_START:
            rest = self._port().read_until(b"\r", deadline - time.monotonic())
            raise DeviceProtocolError(f"{self.port}: {_explain(start + rest)}")
        head = self._read_to(6, deadline)
        length, head_crc = struct.unpack("<HH", head[2:])
        if crc16.arc(head[:4]) != head_crc or length > 4096:
            self._port().discard_input()
            raise DeviceProtocolError(f"{self.port}: wrong CRC of a BX header; check cable and baud rate.")
        body, crc = self._read_to(6 + length, deadline)[6:], self._read_to(8 + length, deadline)[-2:]
        if crc16.arc(body) != int.from_bytes(crc, "little"):
            raise DeviceProtocolError(f"{self.port}: wrong CRC of a BX answer; check cable and baud rate.")
        return body

    def _read_to(self, end: int, deadline: float) -> bytes:
        """The answer's first ``end`` bytes; after a timeout the next call goes on where this one was."""
        missing = max(0, end - len(self._answer))
        self._answer += self._port().read_exactly(missing, deadline - time.monotonic())
        return self._answer[:end]

    def _sample(self, tool: NdiTool) -> TrackerSample:
        pose = None
        if tool.quaternion_wxyz is not None and tool.position_mm is not None:
            w, x, y, z = tool.quaternion_wxyz
            pose = SensorPose.from_quaternion([x, y, z, w], tool.position_mm)
        return Tool(str(self.tool), self.dof).sample(self._stamp(), pose, tool.frame, tool.error_mm)

    def _open(self) -> None:
        self._link = SerialLink(self.port, 9600)
        self._answer, self._late_until_s = b"", -math.inf
        self._initialize()
        self._ask("COMM:50000")
        self._link.set_baud(115200)
        time.sleep(INIT_PAUSE_S)
        for handle in self._handles("01"):
            self._ask(f"PHF:{handle}")
        for handle in self._handles("02"):
            self._ask(f"PINIT:{handle}")
        handles = self._handles("03")
        if self.tool >= len(handles):
            raise DeviceProtocolError(
                f"{self.port}: the tracker sees {len(handles)} tools, number {self.tool} (from 0) is wanted. "
                "Plug the sensor in."
            )
        for handle in handles:
            self._ask(f"PENA:{handle}D")
        self._handle = int(handles[self.tool], 16)
        self._ask("TSTART:")

    def _initialize(self) -> None:
        """Greet the unit; where it does not answer, reset it by a serial break and greet again."""
        assert self._link is not None
        self._link.discard_input()
        try:
            self._ask("INIT:", INIT_TRY_S)
        except (DeviceTimeoutError, DeviceProtocolError):
            self._link.send_break()
            self._link.discard_input()
            answer = self._link.read_until(b"\r", RESET_S)
            if answer + b"\r" != message("RESET"):
                raise DeviceProtocolError(f"{self.port}: {answer!r} after a reset; is this an NDI tracker?") from None
            time.sleep(INIT_PAUSE_S)
            self._ask("INIT:")
        time.sleep(INIT_PAUSE_S)

    def _handles(self, kind: str) -> list[str]:
        """Port handles to free (01), to initialize (02) or to enable (03), as two hex digits each."""
        answer = self._ask(f"PHSR:{kind}")
        if not re.fullmatch(r"[0-9A-F]{2}([0-9A-F]{5})*", answer) or len(answer) != 2 + 5 * int(answer[:2], 16):
            raise DeviceProtocolError(f"{self.port}: unreadable list of tools {answer!r}.")
        count = int(answer[:2], 16)
        return [answer[2 + 5 * n : 4 + 5 * n] for n in range(count)]

    def _ask(self, command: str, timeout_s: float | None = None) -> str:
        """Send a command and return its text answer, CRC checked and cut off."""
        self._port().write(message(command))
        raw = self._port().read_until(b"\r", self.deadline_s if timeout_s is None else timeout_s)
        text = raw[:-4].decode("latin-1")
        if message(text) != raw + b"\r" or text.startswith(("ERROR", "RESET")):
            raise DeviceProtocolError(f"{self.port}: {_explain(raw)} Asked: {command!r}.")
        return text

    def _close(self) -> None:
        if self._link is None:
            return
        try:
            self._link.discard_input()
            self._link.write(message("TSTOP:"))
            self._link.read_until(b"\r", 0.2)
        except DeviceError:
            pass
        finally:
            self._link.close()
            self._link = None

    def _port(self) -> SerialLink:
        if self._link is None:
            self._check_connected()
            raise AssertionError("connected without a link")
        return self._link


def _explain(raw: bytes) -> str:
    """What is wrong with an answer that is not the one hoped for."""
    text = raw[:-4].decode("latin-1")
    if message(text) != raw + b"\r":
        return f"wrong CRC of the answer {raw!r}; check cable and baud rate."
    if text == "RESET":
        return "the tracker was reset in mid-session; connect again."
    code = text.removeprefix("ERROR")
    return f"the tracker says {text!r} ({ERRORS.get(code, 'see its guide')})."
