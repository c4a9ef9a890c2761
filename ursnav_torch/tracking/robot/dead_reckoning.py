"""Dead reckoning: where the camera must have come by what a robot tells of its joints, from picture to picture."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.kidney import LumenDistance
from ursnav_torch.tracking.robot.odometry import STILL, Carried, Odometry, OdometryReading, OdometrySettings
from ursnav_torch.tracking.robot.trail import ShaftTrail

Array = NDArray[np.float64]


class DeadReckoning:
    """What a robot told since the pictures before, if any robot tells.

    Args:
        settings: of the odometry, lengths in mm of this kidney.
        lumen: distances to the wall.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.

    Attributes:
        step: the motion since the picture before; None where nobody told of it.
        carried: the motion since the last picture that showed something; likewise.
    """

    def __init__(self, settings: OdometrySettings, lumen: LumenDistance, unit_mm: float = 1.0) -> None:
        self._odometry = Odometry(settings)
        self._trail = ShaftTrail(self._odometry, lumen, unit_mm)
        self.reset()

    def reset(self) -> None:
        """Forget plays, trail and motion."""
        self._odometry.reset()
        self._trail.reset()
        self._told_s: float | None = None
        self.step: Carried | None = None
        self.carried: Carried | None = None

    @property
    def slider_play_mm(self) -> float | None:
        """Width of the slider's play as pictures have shown it; None where no robot tells where it stands."""
        return None if self._told_s is None else self._odometry.insertion.width()

    def hear(self, reading: OdometryReading | None, t_s: float) -> None:
        """Take in what the robot tells at the time of the next picture, if it tells anything; the first word tells of
        no motion."""
        before_s, self._told_s, self.step = self._told_s, None if reading is None else t_s, None
        if reading is not None:
            told = self._odometry.carried(reading, 0.0 if before_s is None else t_s - before_s)
            self.step = None if before_s is None else told
        known = self.carried is not None and self.step is not None
        self.carried = self.carried.then(self.step) if known else None  # type: ignore[union-attr,arg-type]

    def expected(self) -> list[Array]:
        """Where (4, 4) the tip of a shaft that has been pulled may be, see `ShaftTrail.expected`."""
        return self._trail.expected()

    def learn(self, T_before_now: Array, position_sd_mm: float, turn_sd: float, seconds: float) -> None:
        """Compare the step (4, 4) from the picture before, as pictures show it, with the robot's word on it."""
        if self.step is not None:
            self._odometry.learn(T_before_now, position_sd_mm, turn_sd, seconds)

    def mark(self, T_kidney_camera: Array) -> None:
        """Remember a sure pose (4, 4) of a shaft on its way in."""
        if self.step is not None:
            self._trail.mark(T_kidney_camera)

    def seen(self) -> None:
        """A picture showed where the camera is: motion counts from here."""
        self.carried = STILL
