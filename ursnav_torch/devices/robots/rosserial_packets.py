"""The rosserial protocol, version 2, spoken by the host: packets, topic negotiation, time.

A packet is ``FF FE, length (2), 255 - sum of the length's bytes, topic (2), payload, 255 - sum of topic and
payload`` with everything little-endian. The device announces its topics when asked; the thesis's Arduinos
(§4.3.1, ROS kinetic) speak it through the rosserial_arduino library.
"""

import logging
import struct
import time
from dataclasses import dataclass

from ursnav_torch.devices.serial_link import SerialLink
from ursnav_torch.errors import DeviceError, DeviceProtocolError, DeviceTimeoutError

PUBLISHER, SUBSCRIBER, LOG, TIME, STOP = 0, 1, 7, 10, 11
FIRST_USER_TOPIC = 100
INT32S = ("std_msgs/Int32MultiArray", "1d99f79f8b325b44fee908053e9c945b")
UINT8 = ("std_msgs/UInt8", "7c8164229e7d2c17eb95e9231617fdee")

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Packet:
    """A topic's number and the serialized message."""

    topic: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a device announces: it publishes or subscribes ``name`` under the number ``topic``."""

    topic: int
    name: str
    type_name: str
    md5: str
    buffer_bytes: int = 512

    def pack(self) -> bytes:
        """The serialized rosserial_msgs/TopicInfo."""
        texts = b"".join(struct.pack("<I", len(t)) + t.encode() for t in (self.name, self.type_name, self.md5))
        return struct.pack("<H", self.topic) + texts + struct.pack("<i", self.buffer_bytes)

    @classmethod
    def unpack(cls, payload: bytes) -> "TopicInfo":
        """Read a serialized TopicInfo.

        Raises:
            DeviceProtocolError: it is cut short or no text.
        """
        at, texts = 2, []
        try:
            (topic,) = struct.unpack_from("<H", payload)
            for _ in range(3):
                (length,) = struct.unpack_from("<I", payload, at)
                texts.append(payload[at + 4 : at + 4 + length].decode())
                at += 4 + length
            (buffer_bytes,) = struct.unpack_from("<i", payload, at)
        except (struct.error, UnicodeDecodeError) as error:
            raise DeviceProtocolError(f"unreadable topic announcement ({error}).") from error
        return cls(topic, texts[0], texts[1], texts[2], buffer_bytes)


def pack_packet(packet: Packet) -> bytes:
    """The bytes of a packet."""
    length, topic = struct.pack("<H", len(packet.payload)), struct.pack("<H", packet.topic)
    head = b"\xff\xfe" + length + bytes([255 - sum(length) % 256]) + topic
    return head + packet.payload + bytes([255 - (sum(topic) + sum(packet.payload)) % 256])


class BoardResetError(DeviceProtocolError):
    """A board announces its topics anew: it was reset and counts its steps from zero."""


class Decoder:
    """Finds packets in a stream of bytes."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Add bytes and return the packets that are complete now.

        Bytes between packets are passed over, as boards print text while they boot.

        Raises:
            DeviceProtocolError: a checksum is wrong; the packet is dropped and the next call goes on after it.
        """
        self._buffer += data
        packets = []
        while (packet := self._next()) is not None:
            packets.append(packet)
        return packets

    def _next(self) -> Packet | None:
        start = self._buffer.find(b"\xff\xfe")
        if start < 0:
            del self._buffer[: max(0, len(self._buffer) - 1)]
            return None
        del self._buffer[:start]
        if len(self._buffer) < 8:
            return None
        length, check = struct.unpack_from("<HB", self._buffer, 2)
        if (sum(self._buffer[2:4]) + check) % 256 != 255:
            del self._buffer[:2]
            raise DeviceProtocolError("rosserial: wrong checksum of a packet's length; check cable and baud rate.")
        if len(self._buffer) < 8 + length:
            return None
        raw = bytes(self._buffer[: 8 + length])
        del self._buffer[: 8 + length]
        if sum(raw[5:]) % 256 != 255:
            raise DeviceProtocolError("rosserial: wrong checksum of a packet; check cable and baud rate.")
        return Packet(struct.unpack_from("<H", raw, 5)[0], raw[7:-1])


REQUEST_TOPICS = pack_packet(Packet(PUBLISHER, b""))
STOP_SENDING = pack_packet(Packet(STOP, b""))


def pack_ints(values: list[int]) -> bytes:
    """A serialized std_msgs/Int32MultiArray without dimensions."""
    return struct.pack(f"<3I{len(values)}i", 0, 0, len(values), *values)


def unpack_ints(payload: bytes) -> list[int]:
    """The numbers of a serialized Int32MultiArray without dimensions.

    Raises:
        DeviceProtocolError: it is something else.
    """
    if len(payload) >= 12:
        dimensions, _, count = struct.unpack_from("<3I", payload)
        if dimensions == 0 and len(payload) == 12 + 4 * count:
            return list(struct.unpack_from(f"<{count}i", payload, 12))
    raise DeviceProtocolError(f"rosserial: {payload!r} is not an Int32MultiArray without dimensions.")


def pack_time(seconds: float) -> bytes:
    """A serialized std_msgs/Time."""
    return struct.pack("<II", int(seconds), int(seconds % 1 * 1e9))


class RosserialLink:
    """An open serial port to a rosserial device whose topics are known.

    Args:
        port: device path or pyserial URL.
        baud: 57600 is rosserial's own choice.
        needed: topics the device must announce, name -> (type, md5); which direction is the device's affair.
        deadline_s: how long the device may take to announce them; boards restart when the port opens.

    Attributes:
        since_s: all that `receive` gave last has come since then, however late this program looked.

    Raises:
        DeviceNotConnectedError: no such port.
        DeviceTimeoutError: the needed topics were not announced in time.
        DeviceProtocolError: a topic has another type than needed, or the bytes make no sense.
    """

    def __init__(self, port: str, baud: int, needed: dict[str, tuple[str, str]], deadline_s: float = 5.0) -> None:
        self.port = port
        self._link = SerialLink(port, baud)
        self._decoder = Decoder()
        self._early: list[Packet] = []  # messages that came among the announcements
        self.topics: dict[str, TopicInfo] = {}
        self.since_s = self._emptied_s = 0.0
        try:
            self._negotiate(needed, deadline_s)
        except BaseException:
            self._link.close()
            raise

    def close(self) -> None:
        """Ask the device to stop sending, and close the port."""
        try:
            self._link.write(STOP_SENDING)
        except DeviceError as error:
            logger.debug("closing %s: %s", self.port, error)
        self._link.close()

    def fileno(self) -> int | None:
        """The port's file descriptor, None where the URL is of no real port."""
        return self._link.fileno()

    def packed(self, name: str, payload: bytes) -> bytes:
        """The bytes that publish a serialized message to a topic."""
        return pack_packet(Packet(self.topics[name].topic, payload))

    def publish(self, name: str, payload: bytes) -> None:
        """Send a serialized message to a topic that the device subscribes."""
        self._link.write(self.packed(name, payload))

    def receive(self, timeout_s: float) -> list[tuple[str, bytes]]:
        """Messages that came, as (topic name, payload); waits up to ``timeout_s`` for the first one.

        Raises:
            DeviceProtocolError: a wrong checksum.
        BoardResetError: the device started anew.
            DeviceNotConnectedError: unplugged.
        """
        names = {info.topic: name for name, info in self.topics.items()}
        deadline = time.monotonic() + timeout_s
        while True:
            messages = []
            for packet in [*self._early, *self._read_packets()]:
                if packet.topic in names:
                    messages.append((names[packet.topic], packet.payload))
                elif packet.topic in (PUBLISHER, SUBSCRIBER):
                    raise BoardResetError(f"{self.port}: the board was reset in mid-session; check its power.")
            self._early.clear()
            if messages or time.monotonic() >= deadline:
                return messages
            time.sleep(0.002)

    def _read_packets(self) -> list[Packet]:
        """Packets that came, after the protocol's own business is done."""
        self.since_s, self._emptied_s = self._emptied_s, time.monotonic()
        packets = self._decoder.feed(self._link.read_available())
        for packet in packets:
            if packet.topic == TIME:
                self._link.write(pack_packet(Packet(TIME, pack_time(time.time()))))
            elif packet.topic == LOG:
                logger.info("%s: %s", self.port, packet.payload[5:].decode("utf8", "replace"))
        return packets

    def _negotiate(self, needed: dict[str, tuple[str, str]], deadline_s: float) -> None:
        deadline, ask_again = time.monotonic() + deadline_s, 0.0
        while missing := needed.keys() - self.topics.keys():
            now = time.monotonic()
            if now > deadline:
                raise DeviceTimeoutError(
                    f"{self.port}: the board did not announce {sorted(missing)} within {deadline_s} s (it announced "
                    f"{sorted(self.topics)}); is the right sketch on it, at the right baud rate?"
                )
            if now >= ask_again:
                self._link.write(REQUEST_TOPICS)
                ask_again = now + 1.0
            for packet in self._read_packets():
                if packet.topic in (PUBLISHER, SUBSCRIBER):
                    self._learn(packet.payload, needed)
                elif packet.topic >= FIRST_USER_TOPIC:
                    self._early.append(packet)
            time.sleep(0.002)

    def _learn(self, payload: bytes, needed: dict[str, tuple[str, str]]) -> None:
        try:
            info = TopicInfo.unpack(payload)
        except DeviceProtocolError as error:
            raise DeviceProtocolError(f"{self.port}: {error}") from error
        wanted = needed.get(info.name)
        if wanted and wanted != (info.type_name, info.md5):
            raise DeviceProtocolError(
                f"{self.port}: topic {info.name} is {info.type_name} ({info.md5}), expected {wanted[0]} "
                f"({wanted[1]}); flash a sketch that uses it."
            )
        self.topics[info.name] = info
