"""An EM tracker behind an OpenIGTLink server such as PLUS or 3D Slicer."""

import socket
import struct
import time

from ursnav_torch.devices.base import EmTracker, TrackerSample
from ursnav_torch.devices.igtl.messages import (
    HEADER,
    TOOL_5D,
    Header,
    Message,
    pack_message,
    unpack_position,
    unpack_tracking_data,
    unpack_transform,
)
from ursnav_torch.devices.wire import SensorPose, Tool
from ursnav_torch.errors import (
    DeviceError,
    DeviceNotConnectedError,
    DeviceProtocolError,
    DeviceTimeoutError,
    InputError,
)

#: Names heard that are remembered.
MOST_NAMES = 30


class OpenIgtlTracker(EmTracker):
    """A tool that an OpenIGTLink server sends, as TRANSFORM, POSITION, TDATA or QTDATA.

    Args:
        device: the message's device name, for PLUS ``<Tool>To<Reference>``, or the tool's name inside tracking data.
        host, port: where the server listens.
        dof: 5 for a sensor that does not know its roll; tracking data that says 5D overrides a 6.
        subscribe_ms: ask the server for tracking data at this interval (STT_TDATA); 0 waits for what it sends.
        connect_s: how long the server may take to accept.

    Raises:
        InputError: ``dof`` is neither 5 nor 6.
    """

    def __init__(
        self,
        device: str,
        host: str = "127.0.0.1",
        port: int = 18944,
        dof: int = 5,
        subscribe_ms: int = 0,
        connect_s: float = 2.0,
    ) -> None:
        super().__init__()
        if dof not in (5, 6):
            raise InputError(f"dof must be 5 or 6, got {dof}.")
        self.device, self.host, self.port, self.dof = device, host, port, dof
        self.subscribe_ms, self.connect_s = subscribe_ms, connect_s
        self._socket: socket.socket | None = None
        self._pending = bytearray()
        self._heard: set[str] = set()
        self._count = 0

    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the tool's next pose; messages for others and of unknown kinds are passed over.

        Raises:
            DeviceTimeoutError: none came in time; the message lists the names that were heard.
            DeviceNotConnectedError: the server has gone.
            DeviceProtocolError: wrong checksum or not OpenIGTLink.
        """
        self._check_connected()
        deadline = time.monotonic() + timeout_s
        while True:
            message = self._receive(deadline)
            if (sample := self._sample(message)) is not None:
                return sample

    def _sample(self, message: Message) -> TrackerSample | None:
        """The message as a sample, or None when it is not about our tool."""
        if message.kind in ("TDATA", "QTDATA"):
            tools = unpack_tracking_data(message.kind, message.content)
            for tool in tools:
                self._hear(tool.name)
                if tool.name == self.device:
                    return self._sampled(tool.pose, 5 if tool.kind == TOOL_5D else self.dof)
            return self._sampled(None, self.dof)
        self._hear(message.device)
        if message.device != self.device or message.kind not in ("TRANSFORM", "POSITION"):
            return None
        if any(k.endswith("Status") and v != "OK" for k, v in message.metadata.items()):  # as PLUS marks it
            return self._sampled(None, self.dof)
        unpack = unpack_transform if message.kind == "TRANSFORM" else unpack_position
        return self._sampled(unpack(message.content), self.dof)

    def _hear(self, name: str) -> None:
        """Remember a name for the message that says none was right; a server may send any number of them."""
        if len(self._heard) < MOST_NAMES:
            self._heard.add(name)

    def _sampled(self, pose: SensorPose | None, dof: int) -> TrackerSample:
        self._count += 1
        return Tool(self.device, dof).sample(self._stamp(), pose, self._count)

    def _receive(self, deadline: float) -> Message:
        self._fill(HEADER.size, deadline)
        try:
            header = Header.unpack(bytes(self._pending[: HEADER.size]))
        except DeviceProtocolError:
            self._close()  # where the next message begins cannot be told any more; only a new connection helps
            raise
        self._fill(HEADER.size + header.body_bytes, deadline)
        body = bytes(self._pending[HEADER.size : HEADER.size + header.body_bytes])
        del self._pending[: HEADER.size + header.body_bytes]
        return header.message(body)

    def _fill(self, count: int, deadline: float) -> None:
        """Receive until ``count`` bytes are there; what came before a deadline is kept for the next read."""
        if self._socket is None:
            raise DeviceNotConnectedError("The OpenIGTLink server is not connected; call connect().")
        while len(self._pending) < count:
            self._socket.settimeout(max(deadline - time.monotonic(), 1e-4))
            try:
                data = self._socket.recv(65536)
            except TimeoutError as error:
                heard = f"heard of {sorted(self._heard)}" if self._heard else "nothing was heard"
                raise DeviceTimeoutError(
                    f"No pose of {self.device!r} from {self.host}:{self.port} in time; {heard}. "
                    "Names must agree exactly; for PLUS they are <Tool>To<Reference>."
                ) from error
            except OSError as error:
                raise DeviceNotConnectedError(f"{self.host}:{self.port} is gone ({error}).") from error
            if not data:
                raise DeviceNotConnectedError(f"The server at {self.host}:{self.port} closed the connection.")
            self._pending += data

    def _open(self) -> None:
        self._pending.clear()
        try:
            self._socket = socket.create_connection((self.host, self.port), self.connect_s)
        except OSError as error:
            raise DeviceNotConnectedError(
                f"No OpenIGTLink server at {self.host}:{self.port} ({error}); start PLUS or Slicer's connector."
            ) from error
        if self.subscribe_ms:
            content = struct.pack(">I32s", self.subscribe_ms, b"")
            self._socket.sendall(pack_message(Message("STT_TDATA", "", content, time.time())))

    def _close(self) -> None:
        if self._socket is None:
            return
        try:
            if self.subscribe_ms:
                self._socket.sendall(pack_message(Message("STP_TDATA", "", b"", time.time())))
        except (OSError, DeviceError):
            pass
        finally:
            self._socket.close()
            self._socket = None
