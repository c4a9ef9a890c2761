"""Picture files: their size is known before they are decoded, so that 1 MB of a file cannot take 2 GB of memory."""

import io
import warnings

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ursnav_torch.errors import InputError

#: The finest scopes give 8 megapixels, a photo of a calibration board 12 to 24.
MOST_PIXELS = 40_000_000
#: MOST_PIXELS in color, 16 bits each, not compressed, and room for a file's further data.
MOST_BYTES = 256 << 20


def decode_picture(encoded: bytes, where: str) -> NDArray[np.generic] | None:
    """The picture in a file's bytes as OpenCV decodes it, unchanged; None where there is none.

    Args:
        encoded: the file's bytes.
        where: names it in errors.

    Raises:
        InputError: the picture has more than `MOST_PIXELS` pixels.
    """
    if not encoded:
        return None
    check_picture_size(encoded, where)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)


def check_picture_size(encoded: bytes, where: str) -> None:
    """Refuse a picture by the size that its header declares; nothing is decoded.

    What only OpenCV can read (some TIFF files) is left to OpenCV's own limit, see ``ursnav_torch/__init__.py``.

    Raises:
        InputError: more than `MOST_PIXELS` pixels.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns from 89 megapixels on
            width, height = Image.open(io.BytesIO(encoded)).size
    except Image.DecompressionBombError:
        width, height = 0, 0
    except Exception:  # Pillow's readers raise whatever a damaged header makes them stumble over
        return
    if width * height > MOST_PIXELS or width == 0:
        size = f"{width} x {height} px" if width else "more than 178 megapixels"
        raise InputError(
            f"The picture {where} has {size}; at most {MOST_PIXELS / 1e6:.0f} megapixels are read. Is it a "
            "picture of the scope?"
        )
