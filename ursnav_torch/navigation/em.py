"""Samples of a live EM tracker as readings in the kidney frame."""

from collections.abc import Callable
from pathlib import Path

from ursnav_torch.devices import TrackerSample
from ursnav_torch.registration import readings_in_kidney
from ursnav_torch.tracking.sensor import SensorReading


def sensor_in_kidney(
    em_to_kidney: Path, offset_camera_mm: list[float]
) -> Callable[[TrackerSample], SensorReading | None]:
    """What turns EM samples into readings, see `readings_in_kidney`; None where the sensor is not seen."""
    readings = readings_in_kidney(em_to_kidney, offset_camera_mm)

    def reading(sample: TrackerSample) -> SensorReading | None:
        if not sample.visible or sample.position_mm is None:
            return None
        return readings([sample.position_mm])[0]

    return reading
