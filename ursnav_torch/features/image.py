"""Pictures in: files of any common kind, one gray signal out of them."""

from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.inputs import read_regular
from ursnav_torch.picture_ends import picture_end, what_else
from ursnav_torch.pictures import MOST_BYTES, decode_picture, to_8_bit

#: File name endings that runners take for pictures.
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """A picture as uint8, (H, W) or (H, W, 3) in OpenCV's order blue, green, red.

    Transparency is dropped; 16 bits are scaled by the picture's own maximum, since cameras fill 10 to 16 of them.

    Raises:
        InputError: missing, no regular file, empty, cut short, too large or not a picture.
    """
    return image_from_bytes(read_regular(path, "image", MOST_BYTES), Path(path).name)


def image_from_bytes(data: bytes, where: str) -> NDArray[np.uint8]:
    """`read_image`, (H, W) or (H, W, 3), for a file's bytes; ``where`` names it in errors.

    Raises:
        InputError: see `read_image`.
    """
    if picture_end(data) is None:
        raise InputError(f"The image {where} is cut short ({len(data)} bytes, its end is missing); copy it again.")
    image = decode_picture(data, where)
    if image is None:
        kind = f"is {kind} by its bytes and" if (kind := what_else(data)) else "is"
        raise InputError(f"{where} {kind} not a readable picture ({len(data)} bytes); expected png, jpg, bmp or tif.")
    if not np.isfinite(image).all():
        raise InputError(f"{where} holds gray values that are not finite numbers; save it as 8 or 16 bits.")
    return to_8_bit(image)


def check_image(image: NDArray[np.uint8], camera: Camera) -> None:
    """Refuse what is no picture of the lens: no uint8 array (H, W) or (H, W, 3), or of another size.

    Raises:
        InputError: wrong kind of array or wrong size.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim not in (2, 3):
        kind = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise InputError(f"A picture must be a uint8 array (H, W) or (H, W, 3), got {kind}.")
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"The picture is {width} x {height} px, but the lens is {camera.width} x {camera.height} px; "
            "no one ratio scales one to the other. Say how they were cut: camera=file camera.path=CALIBRATION "
            "camera.crop=[x,y,w,h] camera.resize=[w,h]; or use them as the calibrated camera gives them."
        )


def signal(image: NDArray[np.uint8]) -> Tensor:
    """One gray signal (H, W), float32 in 0..255, from a gray or color picture.

    Channels count by the square of their mean, which is their share of shot-noise-limited signal: a gray scene is
    averaged over all three; in a red one (blood takes green and blue away) red prevails, where vessels show least.
    """
    if image.ndim == 2:
        return torch.from_numpy(np.ascontiguousarray(image)).float()
    weight = np.square(cv2.mean(image)[:3]) + 1e-6
    blue, green, red = (torch.from_numpy(channel).float() for channel in cv2.split(image))
    b, g, r = (float(share) for share in weight / weight.sum())
    return blue.mul_(b).add_(green, alpha=g).add_(red, alpha=r)
