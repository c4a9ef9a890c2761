"""The world of a simulated EM tracker: a frame of its own, a sensor taped beside the camera, noise, distortion."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, quaternion_from_transform, transform_from
from ursnav_torch.simulation.ndi_unit import SensorReading


@dataclass(slots=True)
class EmField:
    """Turns true camera poses into EM readings.

    The EM frame is drawn from the seed: any rotation, 100 to 300 mm away. Distortion is a smooth quadratic warp of
    the field around the place of the first reading; noise is white in position and direction.

    Args:
        noise_mm: RMS of a position's length; the Aurora's 5-DoF sensor has 0.7 (thesis §4.3.2).
        noise_rad: RMS of the direction about each axis; 0.3 degrees.
        distortion_mm: error that the warp reaches 50 mm from its center.
        sensor_offset_mm: the sensor in the camera frame; the thesis's is taped under the camera.
        dropout: share of readings in which the sensor is not seen.
        seed: of frame, warp and noise.

    Raises:
        InputError: a noise or the distortion is negative, or the dropout not in 0 to 1.
    """

    noise_mm: float = 0.7
    noise_rad: float = 0.005
    distortion_mm: float = 0.8
    sensor_offset_mm: tuple[float, float, float] = (0.0, 1.2, -4.0)
    dropout: float = 0.0
    seed: int = 0
    T_em_kidney: Array = field(init=False, repr=False)
    _random: np.random.Generator = field(init=False, repr=False)
    _warp: Array = field(init=False, repr=False)
    _center: Array | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        if min(self.noise_mm, self.noise_rad, self.distortion_mm) < 0 or not 0 <= self.dropout <= 1:
            raise InputError(
                f"EM noise and distortion must not be negative and the dropout lie in 0 to 1; got {self.noise_mm}, "
                f"{self.noise_rad}, {self.distortion_mm}, {self.dropout}."
            )
        self._random = np.random.default_rng(self.seed)
        direction = self._random.normal(size=3)
        away = direction / np.linalg.norm(direction) * self._random.uniform(100.0, 300.0)
        self.T_em_kidney = transform_from(Rotation.random(rng=self._random).as_matrix(), away)
        warp = self._random.normal(size=(3, 6))
        self._warp = warp / np.linalg.norm(warp)

    def read(self, T_kidney_camera: Array) -> SensorReading:
        """Position in mm and quaternion x y z w of the sensor in the EM frame at a camera's pose (4, 4).

        None when it is not seen.
        """
        if self._random.random() < self.dropout:
            return None
        T = self.T_em_kidney @ T_kidney_camera @ transform_from(np.eye(3), self.sensor_offset_mm)
        position = T[:3, 3] + self._distortion(T[:3, 3]) + self._random.normal(size=3) * self.noise_mm / 3**0.5
        turn = Rotation.from_rotvec([*self._random.normal(size=2) * self.noise_rad, 0.0]).as_matrix()
        T = T @ transform_from(turn, [0.0, 0.0, 0.0])
        x, y, z = position.tolist()
        qx, qy, qz, qw = quaternion_from_transform(T).tolist()
        return (x, y, z), (qx, qy, qz, qw)

    def _distortion(self, position: Array) -> Array:
        """Error (3,) in mm of the field at a position (3,)."""
        if self._center is None:
            self._center = position.copy()
        x, y, z = (position - self._center) / 50.0
        return self.distortion_mm * self._warp @ np.array([x * x, y * y, z * z, x * y, y * z, z * x])
