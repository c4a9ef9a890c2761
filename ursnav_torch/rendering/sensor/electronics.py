"""The sensor and what follows it: white balance, Bayer pattern, shot and read noise, 8 bits, JPEG."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Mask

_UNCOMPRESSED = 100


@dataclass(frozen=True, slots=True)
class ElectronicsFaults:
    """What the sensor and its electronics do to the picture. Noise in gray values of 255."""

    gain: float = choice(1.0, "over- or underexposure after the automatic's choice; 0.4-2.5")
    balance_bgr: tuple[float, float, float] = choice((1.0, 1.0, 1.0), "white balance error a channel; 0.85-1.15")
    bayer: bool = choice(False, "one color a pixel, the others interpolated: the thesis's NE2D_RGB sensor (4.3.1)")
    shot_noise: float = setting(0.0, 0, 25, "standard deviation at full white, falls with the root of the signal")
    read_noise: float = setting(0.0, 0, 20, "standard deviation in the dark; thesis 4.1 adds Gaussian noise")
    row_noise: float = setting(0.0, 0, 4, "standard deviation of whole rows: rolling readout of a CMOS sensor")
    jpeg_quality: int = setting(_UNCOMPRESSED, 30, _UNCOMPRESSED, "of the stored picture; 100 leaves it uncompressed")

    def __post_init__(self) -> None:
        check_settings(self)


def digitize(picture: Floats, mask: Mask, faults: ElectronicsFaults, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The 8-bit picture (H, W, 3), blue green red, of light ``picture`` (H, W, 3) in 0..1; black outside ``mask``."""
    raw = 255 * np.float32(faults.gain) * picture * np.array(faults.balance_bgr, np.float32)
    if faults.bayer:
        raw = _noisy(_mosaic(raw)[..., None], faults, rng)[..., 0]
        eight_bit = cv2.cvtColor(np.clip(np.rint(raw), 0, 255).astype(np.uint8), cv2.COLOR_BayerBG2BGR)
    else:
        eight_bit = np.clip(np.rint(_noisy(raw, faults, rng)), 0, 255).astype(np.uint8)
    eight_bit[~mask] = 0
    if faults.jpeg_quality < _UNCOMPRESSED:
        _, stored = cv2.imencode(".jpg", eight_bit, [cv2.IMWRITE_JPEG_QUALITY, int(faults.jpeg_quality)])
        eight_bit = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    return eight_bit


def _mosaic(picture: Floats) -> Floats:
    """(H, W): red at even rows and columns, blue at odd ones, green between (OpenCV's name for it is BayerBG)."""
    raw = picture[..., 1].copy()
    raw[0::2, 0::2] = picture[0::2, 0::2, 2]
    raw[1::2, 1::2] = picture[1::2, 1::2, 0]
    return raw


def _noisy(raw: Floats, faults: ElectronicsFaults, rng: np.random.Generator) -> Floats:
    if faults.shot_noise > 0 or faults.read_noise > 0:
        variance = faults.read_noise**2 + faults.shot_noise**2 / 255 * np.clip(raw, 0, None)
        raw = raw + np.sqrt(variance) * rng.standard_normal(raw.shape, np.float32)
    if faults.row_noise > 0:
        raw = raw + faults.row_noise * rng.standard_normal((len(raw), 1, 1), np.float32)
    return raw
