"""OpenIGTLink messages as bytes: header, checksum and the few types that carry poses.

Written from the protocol's own pages (openigtlink.org/protocols, versions 2 and 3). Everything is big-endian, lengths
mm. pyigtl, the usual package, neither checks checksums nor notices that the other side has gone nor knows
tracking data; it serves as the second opinion in the tests.
"""

import struct
from dataclasses import dataclass, field

import numpy as np
from fastcrc import crc64
from numpy.typing import ArrayLike

from ursnav_torch.devices.wire import SensorPose
from ursnav_torch.errors import DeviceProtocolError
from ursnav_torch.geometry import Array

HEADER = struct.Struct(">H12s20sQQQ")
LARGEST_BODY = 64 * 1024 * 1024
#: Kinds of tool in tracking data: a 5-DoF tool does not know its roll.
TOOL_TRACKER, TOOL_6D, TOOL_3D, TOOL_5D = 1, 2, 3, 4


@dataclass(frozen=True, slots=True)
class Message:
    """A message; ``content`` without extended header and metadata, ``t_s`` seconds since 1970."""

    kind: str
    device: str
    content: bytes
    t_s: float = 0.0
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TrackedTool:
    """A tool in tracking data; ``pose`` is None where it is not seen."""

    name: str
    kind: int
    pose: SensorPose | None


@dataclass(frozen=True, slots=True)
class Header:
    """The 58 bytes before a body."""

    version: int
    kind: str
    device: str
    t_s: float
    body_bytes: int
    crc: int

    @classmethod
    def unpack(cls, raw: bytes) -> "Header":
        """Read 58 bytes.

        Raises:
            DeviceProtocolError: they are no OpenIGTLink header.
        """
        if len(raw) != HEADER.size:
            raise DeviceProtocolError(f"OpenIGTLink: a header has {HEADER.size} bytes, got {len(raw)}.")
        version, kind, device, stamp, size, crc = HEADER.unpack(raw)
        try:
            names = kind.rstrip(b"\0").decode("ascii"), device.rstrip(b"\0").decode("ascii")
        except UnicodeDecodeError:
            names = "", ""
        if version not in (1, 2) or not names[0] or size > LARGEST_BODY:
            raise DeviceProtocolError(f"OpenIGTLink: no header in {raw!r}; is an OpenIGTLink server on that port?")
        return cls(version, *names, stamp / 2**32, size, crc)

    def message(self, body: bytes) -> Message:
        """The message of this header and its body.

        Raises:
            DeviceProtocolError: the checksum is wrong or the extended header does not fit.
        """
        if crc64.ecma_182(body) != self.crc:
            raise DeviceProtocolError(f"OpenIGTLink: wrong checksum of a {self.kind} from {self.device!r}.")
        if self.version == 1:
            return Message(self.kind, self.device, body, self.t_s)
        try:
            extended, meta_head, meta_body, _ = struct.unpack_from(">HHII", body)
            end = len(body) - meta_head - meta_body
            metadata = _metadata(body[end : end + meta_head], body[end + meta_head :])
        except (struct.error, UnicodeDecodeError) as error:
            raise DeviceProtocolError(f"OpenIGTLink: broken extended header of a {self.kind} ({error}).") from error
        return Message(self.kind, self.device, body[extended:end], self.t_s, metadata)


def _metadata(head: bytes, body: bytes) -> dict[str, str]:
    """Metadata of a version-2 message: keys and texts."""
    found, at = {}, 0
    for n in range(struct.unpack_from(">H", head)[0] if head else 0):
        key_bytes, _, value_bytes = struct.unpack_from(">HHI", head, 2 + 8 * n)
        key, value = body[at : at + key_bytes], body[at + key_bytes : at + key_bytes + value_bytes]
        found[key.decode()] = value.decode()
        at += key_bytes + value_bytes
    return found


def pack_message(message: Message) -> bytes:
    """The bytes of a message with a version-1 header, which every receiver understands."""
    head = HEADER.pack(
        1,
        message.kind.encode("ascii"),
        message.device.encode("ascii"),
        int(message.t_s * 2**32),
        len(message.content),
        crc64.ecma_182(message.content),
    )
    return head + message.content


def pack_transform(T: ArrayLike) -> bytes:
    """Content of a TRANSFORM for a pose (4, 4): rotation by columns, then the translation in mm."""
    T = np.asarray(T, float)
    return np.concatenate([T[:3, :3].T.ravel(), T[:3, 3]]).astype(">f4").tobytes()


def unpack_transform(content: bytes) -> SensorPose | None:
    """The pose in a TRANSFORM's content, None where the tool is not seen.

    Raises:
        DeviceProtocolError: it has another length than 48 bytes, or its numbers are no pose.
    """
    if len(content) != 48:
        raise DeviceProtocolError(f"OpenIGTLink: a TRANSFORM has 48 bytes, got {len(content)}.")
    values = np.frombuffer(content, ">f4").astype(float)
    return SensorPose.from_matrix(values[:9].reshape(3, 3).T, values[9:])


def unpack_position(content: bytes) -> SensorPose | None:
    """The pose in a POSITION's content, x y z, then a quaternion x y z w; None where the tool is not seen.

    Raises:
        DeviceProtocolError: it has another length than 28 bytes, or its numbers are no pose.
    """
    if len(content) != 28:
        raise DeviceProtocolError(f"OpenIGTLink: a POSITION has 28 bytes, got {len(content)}.")
    values = np.frombuffer(content, ">f4").astype(float)
    return SensorPose.from_quaternion(values[3:], values[:3])


def pack_tracking_data(tools: list[tuple[str, int, Array]]) -> bytes:
    """Content of a TDATA of tools: name, kind, ``T_em_sensor`` (4, 4); those not seen are left out."""
    return b"".join(
        struct.pack(">20sBB", name.encode("ascii"), kind, 0) + pack_transform(T_em_sensor)
        for name, kind, T_em_sensor in tools
    )


def unpack_tracking_data(kind: str, content: bytes) -> list[TrackedTool]:
    """The tools of a TDATA (matrices) or QTDATA (quaternions).

    Raises:
        DeviceProtocolError: its length is no multiple of a tool's.
    """
    pose_bytes, unpack = (48, unpack_transform) if kind == "TDATA" else (28, unpack_position)
    size = 22 + pose_bytes
    if len(content) % size:
        raise DeviceProtocolError(f"OpenIGTLink: a {kind} of {len(content)} bytes is no multiple of {size}.")
    tools = []
    for at in range(0, len(content), size):
        name, tool_kind, _ = struct.unpack_from(">20sBB", content, at)
        tools.append(
            TrackedTool(name.rstrip(b"\0").decode("ascii", "replace"), tool_kind, unpack(content[at + 22 : at + size]))
        )
    return tools
