"""The simulated devices: the real drivers, each with its counterpart behind a pseudo-terminal or socket."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import DeviceTimeoutError, InputError
from ursnav_torch.geometry import Array, look_along
from ursnav_torch.hardware.base import Frame
from ursnav_torch.hardware.cameras import LensCamera
from ursnav_torch.hardware.em_field import EmField
from ursnav_torch.hardware.grbl import GrblRobot
from ursnav_torch.hardware.grbl_board import GrblBoard
from ursnav_torch.hardware.igtl_server import SimulatedIgtlTracker
from ursnav_torch.hardware.igtl_tracker import OpenIgtlTracker
from ursnav_torch.hardware.ndi import NdiTracker
from ursnav_torch.hardware.ndi_unit import NdiUnit
from ursnav_torch.hardware.rosserial_board import RosserialBoard
from ursnav_torch.hardware.rosserial_robot import RosserialRobot
from ursnav_torch.hardware.simulated_port import SimulatedPort
from ursnav_torch.hardware.twin import Scope, Twin
from ursnav_torch.kidney import Kidney, LumenDistance


def make_twin(
    kidney: Kidney,
    draw: Callable[[Array], NDArray[np.uint8]],
    scope: Scope | None = None,
    em: EmField | None = None,
    start_mm: ArrayLike | None = None,
    direction: ArrayLike | None = None,
) -> Twin:
    """A scope that lies withdrawn in a kidney's pelvis.

    Args:
        kidney: the anatomy; its lumen's walls stop the scope.
        draw: picture uint8 of a camera at ``T_kidney_camera`` (4, 4).
        scope: the scope.
        em: the EM tracker's world.
        start_mm: (3,) where the tip starts, kidney frame; the root of the centerline without it.
        direction: (3,) where it looks; to the middle of the calyces without it.

    Raises:
        InputError: the start is too near a wall or outside.
    """
    start = np.asarray(kidney.centerline.points_mm[0] if start_mm is None else start_mm, float)
    towards = kidney.tips_mm.mean(axis=0) - start if direction is None else np.asarray(direction, float)
    lumen = LumenDistance.from_kidney(kidney)
    return Twin(lumen.clearance_mm, draw, look_along(start, towards), scope, em)


class TwinCamera(LensCamera):
    """The twin's camera: pictures at a steady rate, drawn when they are due.

    Args:
        twin: the scope.
        rate_hz: pictures a second.
        calibration: camera JSON of the lens that the twin draws with, or None.

    Raises:
        InputError: the rate is not positive.
    """

    def __init__(self, twin: Twin, rate_hz: float = 15.0, calibration: str | Path | None = None) -> None:
        super().__init__(calibration)
        if rate_hz <= 0:
            raise InputError(f"rate_hz must be positive, got {rate_hz}.")
        self.twin, self.rate_hz = twin, rate_hz
        self._due_s = 0.0

    def read(self, timeout_s: float = 1.0) -> Frame:
        """Wait for the next picture; raises as `Camera.read` does."""
        self._check_connected()
        wait = self._due_s - time.monotonic()
        time.sleep(max(0.0, min(wait, timeout_s)))
        if wait > timeout_s:
            raise DeviceTimeoutError(f"The next picture is not due within {timeout_s} s.")
        self._due_s = max(self._due_s + 1 / self.rate_hz, time.monotonic() - 1.0)
        stamp = self._stamp()
        return Frame(stamp, self.twin.image())

    def _open(self) -> None:
        self._due_s = time.monotonic()

    def _close(self) -> None: ...


class SimulatedGrblRobot(GrblRobot):
    """The GRBL driver with a simulated board; takes the driver's other settings."""

    def __init__(self, twin: Twin, **settings: Any) -> None:
        self.board = GrblBoard()
        self.board_port = SimulatedPort(self.board)
        super().__init__(self.board_port.path, twin.scope.drive, **settings)
        twin.drive_with(self.board.axes_mm, lambda: self.board.light)

    def dispose(self) -> None:
        """Disconnect and end the simulation."""
        super().dispose()
        self.board_port.close()


class SimulatedRosserialRobot(RosserialRobot):
    """The rosserial driver with a simulated board; takes the driver's other settings."""

    def __init__(self, twin: Twin, **settings: Any) -> None:
        self.board = RosserialBoard()
        self.board_port = SimulatedPort(self.board)
        super().__init__([self.board_port.path], twin.scope.drive, **settings)
        steps_per_mm = np.array(twin.scope.drive.steps_per_mm)
        twin.drive_with(lambda: self.board.steps() / steps_per_mm, lambda: self.board.light)

    def dispose(self) -> None:
        """Disconnect and end the simulation."""
        super().dispose()
        self.board_port.close()


class SimulatedNdiTracker(NdiTracker):
    """The NDI driver with a simulated unit; takes the driver's other settings."""

    def __init__(self, twin: Twin, rate_hz: float = 40.0, **settings: Any) -> None:
        self.unit = NdiUnit(twin.sensor, rate_hz)
        self.unit_port = SimulatedPort(self.unit, period_s=0.002)
        super().__init__(self.unit_port.path, rate_hz=rate_hz, **settings)

    def dispose(self) -> None:
        """Disconnect and end the simulation."""
        super().dispose()
        self.unit_port.close()


class SimulatedOpenIgtlTracker(OpenIgtlTracker):
    """The OpenIGTLink driver with a simulated PLUS server; takes the driver's other settings."""

    def __init__(self, twin: Twin, device: str = "ScopeToTracker", rate_hz: float = 40.0, **settings: Any) -> None:
        self.server = SimulatedIgtlTracker(twin.sensor, device, rate_hz)
        super().__init__(device, port=self.server.port, **settings)

    def dispose(self) -> None:
        """Disconnect and end the simulation."""
        super().dispose()
        self.server.close()
