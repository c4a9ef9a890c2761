"""OpenIGTLink messages of versions 1 and 2 from their bytes: TRANSFORM, IMAGE, STRING, POINT.

Numbers are big-endian, lengths mm, coordinates RAS as Slicer's own.
"""

import struct
from dataclasses import dataclass

import numpy as np

HEADER = struct.Struct(">H12s20sQQQ")
LARGEST_BODY = 64 * 1024 * 1024
_IMAGE = struct.Struct(">HBBBBHHH12f6H")
_POINT = struct.Struct(">64s32s4B4f20s")
_UINT8, _LPS = 3, 2


@dataclass(frozen=True)
class Pose:
    """A transform (4, 4), mm; None where the tool is not seen."""

    device: str
    matrix: "np.ndarray | None"


@dataclass(frozen=True)
class Picture:
    """A picture uint8 (H, W) or (H, W, 3) red, green, blue, and pixel indices (x, y, slice) to RAS, (4, 4)."""

    device: str
    pixels: np.ndarray
    ijk_to_ras: np.ndarray


@dataclass(frozen=True)
class Text:
    """A text."""

    device: str
    text: str


@dataclass(frozen=True)
class Points:
    """Named points (N, 3), RAS, and their diameters (N,), mm."""

    device: str
    names: "tuple[str, ...]"
    at: np.ndarray
    diameter: np.ndarray


def decode(kind, device, version, body):
    """What a message shows; None for kinds that this module has no use for.

    Raises:
        ValueError: the body is not what its kind wants.
    """
    reader = {"TRANSFORM": _pose, "IMAGE": _picture, "STRING": _text, "POINT": _points}.get(kind)
    if reader is None:
        return None
    try:
        return reader(device, _content(version, body))
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"a broken {kind} from {device!r}: {error}") from None


def _content(version, body):
    """The body without the extended header and the metadata of later versions."""
    if version == 1:
        return body
    extended, meta_head, meta_body, _ = struct.unpack_from(">HHII", body)
    return body[extended : len(body) - meta_head - meta_body]


def _pose(device, content):
    values = np.array(struct.unpack(">12f", content))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = values[:9].reshape(3, 3).T, values[9:]
    R = matrix[:3, :3]
    is_pose = np.isfinite(matrix).all() and np.abs(R @ R.T - np.eye(3)).max() < 1e-2
    return Pose(device, matrix if is_pose else None)


def _picture(device, content):
    _, components, scalar, _, system, width, height, depth, *numbers = _IMAGE.unpack_from(content)
    if scalar != _UINT8 or components not in (1, 3) or depth != 1 or numbers[12:] != [0, 0, 0, width, height, 1]:
        raise ValueError(f"{device!r} is no whole picture of bytes")
    pixels = np.frombuffer(content, np.uint8, width * height * components, _IMAGE.size)
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(numbers[:9], (3, 3)).T
    matrix[:3, 3] = np.array(numbers[9:12]) - matrix[:3, :3] @ [(width - 1) / 2, (height - 1) / 2, 0.0]
    if system == _LPS:
        matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ matrix
    return Picture(device, pixels.reshape((height, width, components) if components == 3 else (height, width)), matrix)


def _text(device, content):
    _, length = struct.unpack_from(">HH", content)
    return Text(device, content[4 : 4 + length].decode("utf-8"))


def _points(device, content):
    if len(content) % _POINT.size:
        raise ValueError(f"{device!r} is no whole list of points")
    found = [_POINT.unpack_from(content, at) for at in range(0, len(content), _POINT.size)]
    names = tuple(item[0].split(b"\0")[0].decode("utf-8") for item in found)
    return Points(device, names, np.array([i[6:9] for i in found]).reshape(-1, 3), np.array([i[9] for i in found]))
