"""A simulated OpenIGTLink tracker: what PLUS would send of one wired sensor."""

import socket
import struct
import threading
import time
from collections.abc import Callable

from ursnav_torch.devices.igtl.messages import TOOL_5D, Message, pack_tracking_data
from ursnav_torch.devices.igtl.server import OpenIgtlServer
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.simulation.ndi_unit import SensorReading


class SimulatedIgtlTracker:
    """A simulated PLUS server: sends one 5-DoF tool as TRANSFORM, and as TDATA to those who ask for it.

    Args:
        sensor: called once a frame for the sensor's pose; while it returns None nothing is sent.
        device: the tool's name.
        rate_hz: frames a second.
        port: 0 picks a free one.
    """

    def __init__(
        self,
        sensor: Callable[[], SensorReading],
        device: str = "ScopeToTracker",
        rate_hz: float = 40.0,
        port: int = 0,
    ) -> None:
        self.device = device
        self._sensor, self._rate_hz = sensor, rate_hz
        self._subscribers: set[socket.socket] = set()
        self._end = threading.Event()
        self.server = OpenIgtlServer(port, on_message=self._asked)
        self.port = self.server.port
        self._thread = threading.Thread(target=self._run, name="simulated-igtl", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop sending and close the server."""
        self._end.set()
        self._thread.join(timeout=1.0)
        self.server.close()

    def _asked(self, message: Message, client: socket.socket) -> None:
        if message.kind == "STT_TDATA":
            self._subscribers.add(client)
            self.server.send(Message("RTS_TDATA", "", struct.pack(">B", 0), time.time()), client)
        elif message.kind == "STP_TDATA":
            self._subscribers.discard(client)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._end.wait(max(0.0, due - time.monotonic())):
            due += 1 / self._rate_hz
            reading = self._sensor()
            if self._subscribers:
                tools = [] if reading is None else [(self.device, TOOL_5D, transform_from_quaternion(*reading))]
                message = Message("TDATA", "Tracker", pack_tracking_data(tools), time.time())
                for client in list(self._subscribers):
                    if not self.server.send(message, client):
                        self._subscribers.discard(client)
            elif reading is not None:
                self.server.send_pose(transform_from_quaternion(*reading), self.device)
