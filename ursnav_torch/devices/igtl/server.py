"""An OpenIGTLink server: shows the localized pose to 3D Slicer."""

import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ursnav_torch.devices.base import Frame, Output
from ursnav_torch.devices.igtl.messages import (
    HEADER,
    Header,
    Message,
    pack_message,
    pack_transform,
)
from ursnav_torch.devices.igtl.shown import pack_image, pack_string, pixels_before_camera
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError, InputError
from ursnav_torch.geometry import T_RAS_LPS, Array

logger = logging.getLogger(__name__)

#: What may wait for a client besides a picture: some thousand poses.
LARGEST_BACKLOG = 256 * 1024


@dataclass(slots=True)
class _Client:
    """What came from a client and is no whole message yet, and what it has not taken yet."""

    received: bytearray = field(default_factory=bytearray)
    waiting: bytearray = field(default_factory=bytearray)
    picture_bytes: int = 0

    @property
    def backlog(self) -> int:
        """Bytes that wait, without the last picture's."""
        return len(self.waiting) - self.picture_bytes


class OpenIgtlServer:
    """Sends messages to every client that connects; a client that does not keep up is dropped.

    Of pictures it misses those that come while an earlier one is still on its way to it.

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
        self.welcome: Message | None = None  # what every new client is told first
        self._on_message = on_message
        self._clients: dict[socket.socket, _Client] = {}
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
        """Send a message to all clients, or only to one; returns how many get it. Never waits."""
        raw, reached = pack_message(message), 0
        with self._lock:
            for client in [only] if only else list(self._clients):
                reached += self._give(client, raw, message.kind == "IMAGE")
        return reached

    def _give(self, client: socket.socket, raw: bytes, is_picture: bool) -> bool:
        """Add a message to what a client is to get, and send what it takes; the lock is held."""
        known = self._clients.get(client)
        if known is None or (is_picture and known.waiting):
            return False
        known.waiting += raw
        known.picture_bytes = len(raw) if is_picture else known.picture_bytes
        return self._flush(client, known)

    def _flush(self, client: socket.socket, known: _Client) -> bool:
        """Send what a client takes; whether it is still there. The lock is held."""
        try:
            if known.waiting:
                del known.waiting[: client.send(known.waiting)]
        except BlockingIOError:
            pass
        except OSError as error:
            return self._drop(client, str(error))
        if not known.waiting:
            known.picture_bytes = 0
        if known.backlog > LARGEST_BACKLOG:
            return self._drop(client, "the client does not keep up")
        return True

    def _drop(self, client: socket.socket, why: str) -> bool:
        logger.info("OpenIGTLink client dropped: %s", why)
        self._clients.pop(client, None)
        client.close()
        return False

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
                    self._clients[client] = _Client()
                    if self.welcome:
                        self._give(client, pack_message(self.welcome), is_picture=False)
            except (BlockingIOError, TimeoutError):
                pass
            with self._lock:
                clients = dict(self._clients)
                for client, known in clients.items():
                    self._flush(client, known)
            for client, known in clients.items():
                self._receive(client, known.received)

    def _receive(self, client: socket.socket, received: bytearray) -> None:
        try:
            data = client.recv(65536)
            received += data
            for message in _messages(received):
                if self._on_message:
                    self._on_message(message, client)
        except BlockingIOError:
            return
        except (OSError, DeviceError) as error:
            with self._lock:
                self._drop(client, str(error))
            return
        if not data:
            with self._lock:
                self._drop(client, "it has left")


class SlicerOutput(Output):
    """Shows 3D Slicer the localized camera, its picture and what was seen of the kidney.

    Slicer's world is RAS, and it takes a mesh file for LPS unless the file's header says otherwise; poses are turned to
    where it shows the kidney.

    Args:
        port, host: where to listen; in Slicer add an OpenIGTLink connector as a client to it.
        device: the transform node's name.
        picture_device: the picture's node; put under the transform node it hangs before the camera.
        picture_mm: how wide it is there, and how far away.
        kidney_frame: ``lps`` or ``ras``, the coordinates of the kidney's mesh.

    Raises:
        InputError: another frame.
    """

    def __init__(
        self,
        port: int = 18944,
        host: str = "127.0.0.1",
        device: str = "CameraToKidney",
        picture_device: str = "ScopePicture",
        picture_mm: float = 10.0,
        kidney_frame: str = "lps",
    ) -> None:
        super().__init__()
        if kidney_frame not in ("lps", "ras"):
            raise InputError(f"kidney_frame is {kidney_frame!r}; accepted are lps and ras.")
        self.port, self.host, self.device = port, host, device
        self.picture_device, self.picture_mm = picture_device, picture_mm
        self._T_ras_kidney = T_RAS_LPS if kidney_frame == "lps" else np.eye(4)
        self._server: OpenIgtlServer | None = None

    def publish_pose(self, T_kidney_camera: Array, t_wall_s: float) -> None:
        """Send the pose (4, 4), mm, to every Slicer that listens, in RAS."""
        self._check_connected()
        if self._server:
            self._server.send_pose(self._T_ras_kidney @ T_kidney_camera, self.device, t_wall_s)

    def publish_image(self, frame: Frame) -> None:
        """Send a picture as IMAGE; its place is that before the camera, in the camera's own coordinates."""
        self._check_connected()
        if self._server:
            T = pixels_before_camera(frame.image.shape[1], frame.image.shape[0], self.picture_mm)
            content = pack_image(frame.image, T)
            self._server.send(Message("IMAGE", self.picture_device, content, frame.stamp.t_wall_s))

    def publish_coverage(self, coverage: Mapping[str, tuple[str, float]], t_wall_s: float) -> None:
        """Send verdict and share of every calyx as STRING ``Coverage``, which holds JSON: {"A": ["glimpsed", 0.3]}."""
        self._check_connected()
        if self._server:
            text = json.dumps({name: list(found) for name, found in coverage.items()}, ensure_ascii=False)
            self._server.welcome = Message("STRING", "Coverage", pack_string(text), t_wall_s)
            self._server.send(self._server.welcome)

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
