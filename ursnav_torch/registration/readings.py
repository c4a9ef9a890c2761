"""EM samples as readings in the kidney frame, as tracking takes them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.registration.files import read_em_samples
from ursnav_torch.registration.result import Registration
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.place_search import SensorReading

Array = NDArray[np.float64]

#: Root mean square noise of a 5-DoF sensor, and how far the kidney moves on its own, mm.
SENSOR_MM, BREATH_MM = 0.7, 0.8
#: A reading belongs to a picture taken within this time.
_NEAR_S = 0.25


def readings_in_kidney(
    em_to_kidney: Path, offset_camera_mm: Sequence[float]
) -> Callable[[ArrayLike], list[SensorReading | None]]:
    """What turns positions (N, 3) mm in the EM frame into readings; None where a position is not finite.

    Args:
        em_to_kidney: the file that `register` made.
        offset_camera_mm: (3,) the sensor's place in the camera frame.

    Raises:
        InputError: one of them cannot be used.
    """
    offset = np.asarray(offset_camera_mm, float)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InputError(f"sensor_offset_mm must be [x,y,z] in mm in the camera frame, got {offset_camera_mm}.")
    registration = Registration.from_json(em_to_kidney)

    def readings(position_em_mm: ArrayLike) -> list[SensorReading | None]:
        position = registration.apply(np.asarray(position_em_mm, float))
        tre = np.nan_to_num(registration.tre_mm(position))
        sigma = np.sqrt((SENSOR_MM**2 + tre**2 + BREATH_MM**2) / 3)
        return [
            SensorReading(p, offset, float(s)) if np.isfinite(p).all() else None
            for p, s in zip(position, sigma, strict=True)
        ]

    return readings


def recorded_readings(
    em: Path, em_to_kidney: Path | None, offset_camera_mm: Sequence[float]
) -> Callable[[Moment], SensorReading | None]:
    """Readings of an EM file, found by the picture's name or number, else by the nearest time.

    Raises:
        InputError: no registration is given, or a file cannot be used.
    """
    if em_to_kidney is None:
        raise InputError("em= needs em_to_kidney=, the registration that `register` makes from landmarks.")
    to_kidney, samples = readings_in_kidney(em_to_kidney, offset_camera_mm), read_em_samples(em)
    readings = to_kidney(samples.position_mm)
    rows = {Path(name).stem.lstrip("0") or "0": i for i, name in enumerate(samples.key or ())}

    def reading(moment: Moment) -> SensorReading | None:
        row = rows.get(Path(moment.name).stem.lstrip("0") or "0")
        if row is None and samples.key is None and samples.t_s is not None:
            near = int(np.nanargmin(np.abs(samples.t_s - moment.t_s)))
            row = near if abs(samples.t_s[near] - moment.t_s) <= _NEAR_S else None
        return None if row is None else readings[row]

    return reading
