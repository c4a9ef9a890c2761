"""Lens models that are not ours, fitted: Kannala and Brandt's polynomial through another radius."""

import math
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera.models import radial
from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

#: A fit that misses by more is refused, px.
LARGEST_MISS_PX = 0.5


def fitted_radial(radius: Callable[[Array], Array], focal_px: float, rim_px: float, where: str) -> tuple[float, ...]:
    """k1..k4 of the equidistant model through ``radius``, over the picture up to ``rim_px``; says the largest miss.

    Args:
        radius: offsets (N,) in focal lengths at angles (N,) from the axis, radians.
        focal_px: the focal length.
        rim_px: distance of the farthest pixel from the center.
        where: the file, for people to read.

    Raises:
        InputError: it misses by more than 0.5 px.
    """
    angle = np.linspace(1e-4, math.radians(179), 4000)
    r = radius(angle)
    falls = np.flatnonzero((np.diff(r) <= 0) | ~np.isfinite(r[1:]) | (r[1:] > rim_px / focal_px))
    end = int(falls[0]) + 1 if len(falls) else len(angle)
    if r[end - 1] * focal_px < rim_px - 1:
        raise InputError(
            f"The lens in {where} reaches {r[end - 1] * focal_px:.0f} px from its center, its picture goes to "
            f"{rim_px:.0f} px; it is no calibration of this picture."
        )
    angle, r = angle[:end], r[:end]
    powers = angle[:, None] ** np.arange(3, 11, 2)
    k = np.linalg.lstsq(powers, r - angle, rcond=None)[0]
    miss = float(np.abs(radial(angle, tuple(k)) - r).max() * focal_px)
    if miss > LARGEST_MISS_PX:
        raise InputError(
            f"The lens in {where} is fitted by an equidistant one only to {miss:.2f} px; up to {LARGEST_MISS_PX} px "
            "are accepted. Calibrate it as equidistant (Kannala-Brandt), rational, OCamCalib or double sphere."
        )
    warnings.warn(f"{where} was fitted by an equidistant lens; the largest error is {miss:.3f} px.", stacklevel=4)
    return tuple(float(v) for v in k)
