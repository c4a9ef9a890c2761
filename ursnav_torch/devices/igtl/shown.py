"""Contents of OpenIGTLink messages that are shown and never read here: pictures and texts."""

import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array

_IMAGE = struct.Struct(">HBBBBHHH12f6H")
#: Unsigned bytes; their order, which bytes do not have; RAS.
_UINT8, _LITTLE, _RAS = 3, 2, 1
#: What a size, or a text's length, may be: it is told in two bytes.
_LARGEST = 0xFFFF
#: UTF-8 by its number among IANA's character sets (MIBenum).
_UTF_8 = 106


def pack_image(picture: NDArray[np.uint8], T_ras_pixel: ArrayLike) -> bytes:
    """Content of an IMAGE, version 1: one slice.

    Args:
        picture: uint8 (H, W) gray, or (H, W, 3) in OpenCV's order blue, green, red; it is sent as red, green, blue.
        T_ras_pixel: (4, 4) pixel indices (x, y, slice) to mm; it may hold the pixels' size.

    Raises:
        InputError: the picture is larger than the message can say, or is none.
    """
    picture = np.asarray(picture)
    height, width = picture.shape[:2]
    sizes_fit = 0 < min(height, width) and max(height, width) <= _LARGEST
    if picture.dtype != np.uint8 or picture.shape[2:] not in ((), (3,)) or not sizes_fit:
        raise InputError(f"A picture is uint8 (H, W) or (H, W, 3), got {picture.dtype} {picture.shape}.")
    T = np.asarray(T_ras_pixel, float)
    center = T @ [(width - 1) / 2, (height - 1) / 2, 0.0, 1.0]
    components = 1 if picture.ndim == 2 else 3
    numbers = (*T[:3, 0], *T[:3, 1], *T[:3, 2], *center[:3])
    whole = (0, 0, 0, width, height, 1)
    head = _IMAGE.pack(1, components, _UINT8, _LITTLE, _RAS, width, height, 1, *numbers, *whole)
    return head + np.ascontiguousarray(picture if picture.ndim == 2 else picture[..., ::-1]).tobytes()


def pixels_before_camera(width: int, height: int, wide_mm: float) -> Array:
    """``T_camera_pixel`` (4, 4) of a picture that hangs before the camera, ``wide_mm`` wide and as far away."""
    size = wide_mm / width
    T = np.diag([size, size, size, 1.0])
    T[:3, 3] = (-size * (width - 1) / 2, -size * (height - 1) / 2, wide_mm)
    return T


def pack_string(text: str) -> bytes:
    """Content of a STRING.

    Raises:
        InputError: it is longer than the message can say.
    """
    data = text.encode("utf-8")
    if len(data) > _LARGEST:
        raise InputError(f"A text of {len(data)} bytes does not fit into a STRING; at most {_LARGEST} do.")
    return struct.pack(">HH", _UTF_8, len(data)) + data
