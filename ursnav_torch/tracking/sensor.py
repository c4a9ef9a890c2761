"""What an EM sensor on the tip says of the camera's pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Log-probability density at which a reading that fits nowhere stops counting.
_SENSOR_WRONG = -8.0


@dataclass(frozen=True, slots=True)
class SensorReading:
    """Where the EM sensor is, in the kidney frame.

    Attributes:
        position_mm: (3,) kidney frame.
        offset_camera_mm: (3,) the sensor's place in the camera frame.
        sigma_mm: standard deviation of the position along each axis, registration included.
    """

    position_mm: Array
    offset_camera_mm: Array
    sigma_mm: float

    def off(self, T_kidney_camera: Array, coarse_mm: float = 0.0) -> Array:
        """(N,) standard deviations by which poses (N, 4, 4), themselves ``coarse_mm`` coarse, miss the reading."""
        at = T_kidney_camera[:, :3, :3] @ self.offset_camera_mm + T_kidney_camera[:, :3, 3]
        return np.linalg.norm(at - self.position_mm, axis=1) / np.hypot(self.sigma_mm, coarse_mm)

    def log_probability(self, T_kidney_camera: Array, coarse_mm: float = 0.0) -> Array:
        """Of poses (N, 4, 4), up to a constant; a reading that fits nowhere stops counting: the sensor may be wrong."""
        return np.logaddexp(-0.5 * self.off(T_kidney_camera, coarse_mm) ** 2, _SENSOR_WRONG)

    def camera_at(self, T_kidney_camera: Array) -> Array | None:
        """Where (3,) the camera is if it looks as in a pose (4, 4); None where that contradicts the pose."""
        T = T_kidney_camera
        at = self.position_mm - T[:3, :3] @ self.offset_camera_mm
        return at if np.linalg.norm(at - T[:3, 3]) <= 4 * self.sigma_mm else None
