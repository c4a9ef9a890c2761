"""The LED that hangs on the robot's controller."""

from ursnav_torch.devices.base import Lamp, LightSample
from ursnav_torch.devices.robots.robot import Robot
from ursnav_torch.errors import InputError


class RobotLight(Lamp):
    """The LED on the robot's own controller; connected as long as the robot is.

    Raises:
        InputError: there is no robot.
    """

    def __init__(self, robot: Robot | None) -> None:
        super().__init__()
        if robot is None:
            raise InputError("The light hangs on the robot's controller, but there is no robot; choose another light.")
        self.robot = robot

    def set_level(self, level: float) -> LightSample:
        """Dim through the controller; motion may pause for it."""
        self._check_connected()
        return LightSample(self._stamp(), self.robot.set_light(level))

    def _open(self) -> None:
        self.robot.connect()

    def _close(self) -> None: ...
