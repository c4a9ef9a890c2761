"""The simulated devices: the real drivers, each with its counterpart behind a pseudo-terminal or socket."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ursnav_torch.devices import Frame, GrblRobot, NdiTracker, OpenIgtlTracker, RobotSample, RosserialRobot
from ursnav_torch.devices.cameras import LensCamera
from ursnav_torch.errors import DeviceTimeoutError, InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.simulation.em_field import EmField
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.igtl_tracker import SimulatedIgtlTracker
from ursnav_torch.simulation.ndi_unit import NdiUnit
from ursnav_torch.simulation.port import SimulatedPort
from ursnav_torch.simulation.rosserial_board import RosserialBoard
from ursnav_torch.simulation.tissue import TissueSettings, draw_tissue
from ursnav_torch.simulation.twin import Scope, Twin
from ursnav_torch.simulation.world import Draw, World, clean, operated_twin

if TYPE_CHECKING:
    from ursnav_torch.rendering.sensor import Stone
    from ursnav_torch.simulation.stones import ObstructedLumen


def make_twin(
    world: World,
    scope: Scope | None = None,
    em: EmField | None = None,
    sensor: str | None = None,
    seed: int = 0,
    tissue: TissueSettings | None = None,
    stones: int = 0,
) -> Twin:
    """A scope that lies withdrawn in a kidney's pelvis and looks to the middle of its calyces.

    Args:
        world: the anatomy, whose walls stop the scope, and what draws it.
        scope: the scope.
        em: the EM tracker's world.
        sensor: preset of what spoils its pictures (``thesis_simulation``, ``thesis_phantom``, ``in_vivo_like``); None
            for clean ones, gray.
        seed: of the faults, of the tissue and of the stones.
        tissue: what an operation does to the kidney: breath, swelling, bleeding, a shaft that buckles; None for
            nothing.
        stones: how many lie on the wall, as `StoneSettings` draws them; they stop the scope, and its pictures show
            them. With 0, a preset's pictures may show some that lie nowhere.

    Raises:
        InputError: an unknown preset, stones without one, or the root of the centerline lies in a wall.
    """
    start = world.kidney.centerline.points_mm[0]
    T_kidney_start = look_along(start, world.kidney.tips_mm.mean(axis=0) - start)
    drawn = draw_tissue(tissue, [seed, 1], world.kidney.scale)
    if not stones:
        return operated_twin(world, T_kidney_start, scope, drawn, em, _faulty(sensor, seed))
    if sensor is None:
        raise InputError(f"stones={stones} need pictures that can show them: give sensor=thesis_simulation or another.")
    lumen, laid = _with_stones(world, stones, np.random.default_rng([seed, 2]))
    return operated_twin(replace(world, lumen=lumen), T_kidney_start, scope, drawn, em, _faulty(sensor, seed, laid))


def _with_stones(world: World, count: int, rng: np.random.Generator) -> "tuple[ObstructedLumen, tuple[Stone, ...]]":
    """A world's lumen with stones in it, and the stones."""
    from ursnav_torch.simulation.stones import ObstructedLumen, lay_stones  # brings torch, as in `_faulty`

    lumen = LumenDistance.from_kidney(world.kidney) if world.lumen is None else world.lumen
    if isinstance(lumen, ObstructedLumen):
        raise InputError("The world has stones already; give stones=0.")
    stones = lay_stones(world.kidney, lumen, count, rng)
    return ObstructedLumen(lumen, stones), stones


def _faulty(sensor: str | None, seed: int, stones: "tuple[Stone, ...] | None" = None) -> Draw:
    """What spoils the pictures of a preset, with the stones that lie there; clean ones without a preset."""
    if sensor is None:
        return clean
    from ursnav_torch.rendering.sensor import severity, simulate_labeled  # brings torch, for which a lab need not wait

    rng = np.random.default_rng(seed)
    faults = severity(sensor, 0.5, rng)
    return lambda renderer, T: simulate_labeled(renderer.render(T), renderer.camera, T, faults, rng, stones).image


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

    simulated = True

    def __init__(self, twin: Twin, **settings: Any) -> None:
        self.board = GrblBoard()
        self.board_port = SimulatedPort(self.board)
        super().__init__(self.board_port.path, twin.scope.drive, **settings)
        twin.drive_with(self.board.axes_mm, lambda: self.board.light)

    def read(self, timeout_s: float = 0.5) -> RobotSample:
        """As `Robot.read`, but with all the time that a simulated board is given on a busy machine."""
        return super().read(max(timeout_s, self.deadline_s))

    def dispose(self) -> None:
        """Disconnect and end the simulation."""
        super().dispose()
        self.board_port.close()


class SimulatedRosserialRobot(RosserialRobot):
    """The rosserial driver with a simulated board; takes the driver's other settings."""

    simulated = True

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
