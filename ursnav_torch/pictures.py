"""Picture files: their size is known before they are decoded, so that 1 MB of a file cannot take 2 GB of memory."""

import contextlib
import io
import re
import warnings

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ursnav_torch.errors import InputError
from ursnav_torch.picture_ends import PNG, picture_end, pictures_within

#: The finest scopes give 8 megapixels, a photo of a calibration board 12 to 24.
MOST_PIXELS = 40_000_000
#: MOST_PIXELS in color, 16 bits each, not compressed, and room for a file's further data.
MOST_BYTES = 256 << 20
#: The kinds of files that are taken for pictures, in Pillow's words.
_FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
#: Gray stays gray, 16 bits stay 16; only without IMREAD_UNCHANGED does OpenCV turn a picture as its EXIF data say.
_AS_SEEN = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH


def decode_picture(encoded: bytes, where: str) -> NDArray[np.generic] | None:
    """The picture in a file's bytes, turned as its EXIF orientation says, else as it is; None where there is none.

    It is (H, W), or (H, W, 3) in OpenCV's order blue, green, red, of the file's own depth.

    Args:
        encoded: the file's bytes.
        where: names it in errors.

    Raises:
        InputError: the picture has more than `MOST_PIXELS` pixels, or the file holds several pictures.
    """
    pixels, pages = _declared(encoded)
    if pixels is None:
        return None
    if encoded.startswith(PNG) and picture_end(encoded) is None:  # else OpenCV makes room for it, to 4 GiB
        return None
    if pixels > MOST_PIXELS:
        raise InputError(
            f"The picture {where} has {pixels / 1e6:.0f} megapixels; at most {MOST_PIXELS / 1e6:.0f} are read. Is it "
            "a picture of the scope?"
        )
    if pages > 1:
        raise InputError(
            f"{where} holds {pages} pictures (pages) in one file, of which one alone would be read; save each as "
            "a file of its own, or all as a video."
        )
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(np.frombuffer(encoded, np.uint8), _AS_SEEN)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)


def _declared(encoded: bytes) -> tuple[int | None, int]:
    """Width times height that a file's header declares, None where no reader of headers finds any, and its pages.

    What they do not know, OpenCV is not asked to decode: it knows rarer formats, some of which have no limits.
    """
    with warnings.catch_warnings(), contextlib.suppress(Exception):  # they raise whatever they stumble over
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(io.BytesIO(encoded), formats=_FORMATS) as picture:
                tiff = picture.format == "TIFF"
                pages = int(getattr(picture, "n_frames", 1)) if tiff else pictures_within(encoded)
                return int(picture.width * picture.height), pages
        except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
            return int("".join(re.findall(r"\((\d+) pixels\)", str(error)))[:18]), 1
        except UnidentifiedImageError:  # of the TIFF files Pillow knows the more common only
            with tifffile.TiffFile(io.BytesIO(encoded)) as file:
                page = file.pages.first
                return int(page.imagewidth) * int(page.imagelength), len(file.pages)
    return None, 1


def to_8_bit(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """A picture (H, W) or (H, W, 3 or 4) as uint8 without transparency; deeper ones are scaled by their own maximum.

    What is below 0 is black.
    """
    if image.ndim == 3:
        image = image[..., 0] if image.shape[2] == 1 else image[..., :3]
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, np.uint8)
    x = np.maximum(image.astype(np.float64 if image.dtype.itemsize > 4 else np.float32), 0)
    top = float(x.max())
    x *= 255 / top if top > 1e-30 else 0
    return np.rint(x, out=x).astype(np.uint8)
