"""An OpenIGTLink server: shows the localized pose to 3D Slicer."""

import logging
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from numpy.typing import ArrayLike

from ursnav_torch.devices.base import Output
from ursnav_torch.devices.igtl.messages import (
    HEADER,
    Header,
    Message,
    pack_message,
    pack_transform,
)
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError
from ursnav_torch.geometry import Array

logger = logging.getLogger(__name__)


class OpenIgtlServer:
    """Sends messages to every client that connects; a client that does not keep up is dropped.

    In Slicer add an OpenIGTLink connector as a client to this address. A context manager.

    Args:
        port: 0 picks a free one, see ``port`` afterwards.
        host: where to listen; only this machine unless told otherwise.
        on_message: called in the server's thread with what clients send.

    Raises:
        DeviceNotConnectedError: the address is taken.
    """

    def __init__(
        self,
        port: int = 18944,
        host: str = "127.0.0.1",
        on_message: Callable[[Message, socket.socket], None] | None = None,
    ) -> None:
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise DeviceNotConnectedError(f"Cannot listen on {host}:{port} ({error}); choose another port.") from error
        self.port: int = self._listener.getsockname()[1]
        self._on_message = on_message
        self._clients: dict[socket.socket, bytearray] = {}
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="openigtlink-server", daemon=True)
        self._thread.start()

    def send_pose(self, T: ArrayLike, device: str = "CameraToKidney", t_wall_s: float | None = None) -> int:
        """Send a pose (4, 4), mm, as a TRANSFORM; Slicer shows it as a transform node named ``device``.

        Returns:
            How many clients got it.
        """
        stamp = time.time() if t_wall_s is None else t_wall_s
        return self.send(Message("TRANSFORM", device, pack_transform(T), stamp))

    def send(self, message: Message, only: socket.socket | None = None) -> int:
        """Send a message to all clients, or only to one; returns how many got it."""
        raw, reached = pack_message(message), 0
        with self._lock:
            for client in [only] if only else list(self._clients):
                try:
                    if client.send(raw) < len(raw):
                        raise BlockingIOError("the client does not keep up")
                    reached += 1
                except OSError as error:
                    logger.info("OpenIGTLink client dropped: %s", error)
                    self._clients.pop(client, None)
                    client.close()
        return reached

    def close(self) -> None:
        """End the thread and close all connections; closing twice does nothing."""
        self._end.set()
        self._thread.join(timeout=1.0)
        self._listener.close()
        with self._lock:
            for client in self._clients:
                client.close()
            self._clients.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _serve(self) -> None:
        self._listener.settimeout(0.0)
        while not self._end.wait(0.005):
            try:
                client, _ = self._listener.accept()
                client.settimeout(0.0)
                with self._lock:
                    self._clients[client] = bytearray()
            except (BlockingIOError, TimeoutError):
                pass
            with self._lock:
                clients = dict(self._clients)
            for client, pending in clients.items():
                self._receive(client, pending)

    def _receive(self, client: socket.socket, pending: bytearray) -> None:
        try:
            data = client.recv(65536)
            pending += data
            for message in _messages(pending):
                if self._on_message:
                    self._on_message(message, client)
        except BlockingIOError:
            return
        except (OSError, DeviceError) as error:
            logger.info("OpenIGTLink client dropped: %s", error)
            data = b""
        if not data:
            with self._lock:
                self._clients.pop(client, None)
            client.close()


class SlicerOutput(Output):
    """Shows the localized camera to 3D Slicer: a transform node that follows it.

    Args:
        port, host: where to listen; in Slicer add an OpenIGTLink connector as a client to it.
        device: the transform node's name.
    """

    def __init__(self, port: int = 18944, host: str = "127.0.0.1", device: str = "CameraToKidney") -> None:
        super().__init__()
        self.port, self.host, self.device = port, host, device
        self._server: OpenIgtlServer | None = None

    def publish_pose(self, T_kidney_camera: Array, t_wall_s: float) -> None:
        """Send the pose (4, 4), mm, to every Slicer that listens."""
        self._check_connected()
        if self._server:
            self._server.send_pose(T_kidney_camera, self.device, t_wall_s)

    def _open(self) -> None:
        self._server = OpenIgtlServer(self.port, self.host)
        self.port = self._server.port

    def _close(self) -> None:
        if self._server:
            self._server.close()
            self._server = None


def _messages(pending: bytearray) -> list[Message]:
    """Take the complete messages out of ``pending``."""
    found = []
    while len(pending) >= HEADER.size:
        header = Header.unpack(bytes(pending[: HEADER.size]))
        end = HEADER.size + header.body_bytes
        if len(pending) < end:
            break
        found.append(header.message(bytes(pending[HEADER.size : end])))
        del pending[:end]
    return found
