"""A simulated Arduino that runs the thesis's motors and LED under rosserial."""

import struct
import threading
import time
from collections.abc import Callable

import numpy as np

from ursnav_torch.devices.robots.rosserial import BEND, BEND_POSITION, LIGHT, SLIDER, SLIDER_POSITION
from ursnav_torch.devices.robots.rosserial_packets import (
    FIRST_USER_TOPIC,
    INT32S,
    PUBLISHER,
    STOP,
    SUBSCRIBER,
    TIME,
    UINT8,
    Decoder,
    Packet,
    TopicInfo,
    pack_ints,
    pack_packet,
    unpack_ints,
)
from ursnav_torch.errors import DeviceProtocolError
from ursnav_torch.geometry import Array

LONGEST_ORDER_MS = 500
REPORT_S = 0.05
TIME_SYNC_S = 5.0
#: What the board publishes and subscribes, in the order in which it announces them.
TOPICS = [
    (PUBLISHER, BEND_POSITION, INT32S),
    (PUBLISHER, SLIDER_POSITION, INT32S),
    (SUBSCRIBER, BEND, INT32S),
    (SUBSCRIBER, SLIDER, INT32S),
    (SUBSCRIBER, LIGHT, UINT8),
]


class RosserialBoard:
    """Answers host bytes like the motor sketch; give `SimulatedPort` one to have it on a serial port.

    Attributes:
        light: the LED's level from 0 to 1.
        answering: False makes it deaf and dumb, as a hung board is.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.light = 0.0
        self.answering = True
        self._lock = threading.RLock()
        self._clock, self._now = clock, clock()
        self._decoder = Decoder()
        self._numbers = {name: FIRST_USER_TOPIC + n for n, (_, name, _) in enumerate(TOPICS)}
        self._names = {number: name for name, number in self._numbers.items()}
        self._steps = np.zeros(3)
        self._velocity = np.zeros(3)
        self._until_s = np.zeros(3)
        self._announced = False
        self._report_s = self._sync_s = 0.0

    @property
    def moving(self) -> bool:
        """True while a motor turns."""
        self.advance()
        return bool(self._is_moving().any())

    def steps(self) -> Array:
        """Where the motors x, y, z are now, (3,) steps."""
        with self._lock:
            self.advance()
            return self._steps.copy()

    def restart(self) -> bytes:
        """Start anew, as after a brown-out; the text that it prints.

        It obeys orders at once, but publishes nothing until a host asks for its topics, as rosserial_arduino's node
        handle does (``publish`` returns at once where it is not ``configured_``, and a reset forgets that).
        """
        with self._lock:
            self.advance()
            self._steps, self._velocity, self._announced, self.light = np.zeros(3), np.zeros(3), False, 0.0
            self._decoder = Decoder()
            return b"booting\r\n"

    def handle(self, data: bytes) -> bytes:
        """Bytes from the host in, the board's answer out."""
        with self._lock:
            self.advance()
            if not self.answering:
                return b""
            try:
                packets = self._decoder.feed(data)
            except DeviceProtocolError:  # the real board drops a broken packet, too
                packets = []
            return b"".join(self._packet(packet) for packet in packets) + self._report()

    def advance(self) -> None:
        """Let the motors run until now."""
        with self._lock:
            now = self._clock()
            running = np.clip(np.minimum(self._until_s, now) - self._now, 0.0, None)
            self._steps = self._steps + self._velocity * running
            self._now = now

    def _is_moving(self) -> np.ndarray:
        return (self._until_s > self._now) & (self._velocity != 0)

    def _packet(self, packet: Packet) -> bytes:
        if packet.topic == PUBLISHER and not packet.payload:
            return self._announce()
        if packet.topic == STOP:
            self._announced = False
        name = self._names.get(packet.topic)
        if name == LIGHT and len(packet.payload) == 1:
            self.light = packet.payload[0] / 255
        elif name == BEND:
            self._order(slice(0, 2), packet.payload)
        elif name == SLIDER:
            self._order(slice(2, 3), packet.payload)
        return b""

    def _order(self, motors: slice, payload: bytes) -> None:
        *steps, milliseconds = unpack_ints(payload)
        seconds = min(max(milliseconds, 0), LONGEST_ORDER_MS) / 1000
        self._velocity[motors] = np.array(steps) / seconds if seconds else 0.0
        self._until_s[motors] = self._now + seconds

    def _announce(self) -> bytes:
        self._announced = True
        infos = [(kind, TopicInfo(self._numbers[name], name, *message)) for kind, name, message in TOPICS]
        return b"".join(pack_packet(Packet(kind, info.pack())) for kind, info in infos)

    def _report(self) -> bytes:
        if not self._announced:
            return b""
        answer = b""
        if self._now - self._sync_s >= TIME_SYNC_S:
            self._sync_s = self._now
            answer += pack_packet(Packet(TIME, struct.pack("<II", 0, 0)))
        if self._now - self._report_s >= REPORT_S:
            self._report_s = self._now
            x, y, z = np.rint(self._steps).astype(int).tolist()
            moving = self._is_moving()
            answer += self._message(BEND_POSITION, [x, y, int(moving[:2].any())])
            answer += self._message(SLIDER_POSITION, [z, int(moving[2])])
        return answer

    def _message(self, name: str, values: list[int]) -> bytes:
        return pack_packet(Packet(self._numbers[name], pack_ints(values)))
