"""EM samples as readings in the kidney frame."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.hardware import TrackerSample
from ursnav_torch.localization.track_search import SensorReading
from ursnav_torch.registration import Registration

#: Root mean square noise of a 5-DoF sensor, and how far the kidney moves on its own, mm.
SENSOR_MM, BREATH_MM = 0.7, 0.8


def sensor_in_kidney(
    em_to_kidney: Path, offset_camera_mm: list[float]
) -> Callable[[TrackerSample], SensorReading | None]:
    """What turns EM samples into readings; None for a sample in which the sensor is not seen.

    Args:
        em_to_kidney: the file that `register` made.
        offset_camera_mm: the sensor's place in the camera frame.

    Raises:
        InputError: one of them cannot be used.
    """
    offset = np.asarray(offset_camera_mm, float)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InputError(f"sensor_offset_mm must be [x,y,z] in mm in the camera frame, got {offset_camera_mm}.")
    registration = Registration.from_json(em_to_kidney)

    def reading(sample: TrackerSample) -> SensorReading | None:
        if not sample.visible or sample.position_mm is None:
            return None
        position = registration.apply(np.array([sample.position_mm]))
        tre = float(np.nan_to_num(registration.tre_mm(position))[0])
        return SensorReading(position[0], offset, float(np.sqrt((SENSOR_MM**2 + tre**2 + BREATH_MM**2) / 3)))

    return reading
