"""What every device promises, and the records that devices exchange with the rest of the program."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import DeviceNotConnectedError

Vector3 = tuple[float, float, float]

#: A device that has told nothing for longer than this, s, is silent: what it told before says nothing of now, live and
#: in a recording.
SILENT_S = 0.5


@dataclass(frozen=True, slots=True)
class Stamp:
    """When a sample was taken: ``sequence`` counts from 0 for each device, a gap means a lost sample."""

    sequence: int
    t_mono_s: float
    t_wall_s: float


class Stamper:
    """Hands out stamps with consecutive sequence numbers; may be shared by threads.

    Args:
        clock: seconds on a monotonic clock; a simulation may run by one of its own.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._next = 0
        self._lock = threading.Lock()

    def __call__(self) -> Stamp:
        with self._lock:
            sequence, self._next = self._next, self._next + 1
        return Stamp(sequence, self._clock(), time.time())


@dataclass(frozen=True, slots=True)
class Frame:
    """A picture: ``image`` uint8 (H, W) gray or (H, W, 3) in OpenCV's order blue, green, red.

    ``encoded`` holds the camera's own compressed bytes where it gave any, ``suffix`` their file type
    (``jpg``, ``png``); a recorder keeps them as they are. ``source`` is the file a picture came from.
    """

    stamp: Stamp
    image: NDArray[np.uint8]
    encoded: bytes | None = None
    suffix: str = "png"
    source: str = ""


@dataclass(frozen=True, slots=True)
class TrackerSample:
    """A sensor's pose in the EM frame; position, axis and quaternion are None while it is not ``visible``.

    ``axis`` is the sensor's z axis as a unit vector. A 5-DoF sensor (``dof`` 5) does not know its roll, so its
    quaternion stays None. ``source_frame`` is the tracker's own counter, ``error_mm`` its own estimate.
    """

    stamp: Stamp
    visible: bool
    position_mm: Vector3 | None = None
    axis: Vector3 | None = None
    quaternion_xyzw: tuple[float, float, float, float] | None = None
    dof: int = 5
    tool: str = ""
    source_frame: int = 0
    error_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Joints:
    """Where the robot stands: bend about the tip's x and y axes, slider position (forward is positive)."""

    bend_x_rad: float = 0.0
    bend_y_rad: float = 0.0
    insertion_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class JointRates:
    """How fast the robot moves or shall move."""

    bend_x_rad_s: float = 0.0
    bend_y_rad_s: float = 0.0
    insertion_mm_s: float = 0.0

    @property
    def is_zero(self) -> bool:
        """True when nothing moves."""
        return not (self.bend_x_rad_s or self.bend_y_rad_s or self.insertion_mm_s)


@dataclass(frozen=True, slots=True)
class RobotSample:
    """The robot's own report; ``state`` is ``disarmed``, ``armed`` or ``stopped`` (to be acknowledged).

    Where ``place_known`` is false its controller was reset, and ``joints`` are the last that were certain.
    """

    stamp: Stamp
    joints: Joints
    moving: bool
    state: str
    place_known: bool = True


@dataclass(frozen=True, slots=True)
class CommandSample:
    """What the operator asked for and what was really sent; ``reason`` says why they differ."""

    stamp: Stamp
    requested: JointRates
    sent: JointRates
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LightSample:
    """The LED's level as sent, from 0 (off) to 1."""

    stamp: Stamp
    level: float


@dataclass(frozen=True, slots=True)
class OperatorInput:
    """The operator's hands: rates from -1 to 1, and buttons.

    ``dead_man`` must be held for anything to move. ``light_step`` brightens (+1) or dims (-1). The four
    buttons after it are true in the one sample in which they went down, ``emergency_stop`` as long as held.
    """

    stamp: Stamp
    bend_x: float = 0.0
    bend_y: float = 0.0
    insertion: float = 0.0
    dead_man: bool = False
    light_step: int = 0
    arm: bool = False
    acknowledge: bool = False
    snapshot: bool = False
    quit: bool = False
    emergency_stop: bool = False


@dataclass(frozen=True, slots=True)
class Note:
    """Something worth telling that is no sample; ``level`` is ``info``, ``warning`` or ``error``."""

    stamp: Stamp
    level: str
    text: str


class SourceAtEndError(DeviceNotConnectedError):
    """A source that plays something has played all of it."""


class Device(ABC):
    """Something that is connected, used and disconnected; a ``with`` block does the first and the last.

    ``connect`` on a connected device and ``disconnect`` on a disconnected one do nothing. ``stop`` ends all
    motion, may be called at any time, from any state and thread, and any number of times.
    """

    def __init__(self) -> None:
        self._stamp = Stamper()
        self._connected = False

    @property
    def is_connected(self) -> bool:
        """True between ``connect`` and ``disconnect``."""
        return self._connected

    def connect(self) -> None:
        """Open the device.

        Raises:
            DeviceNotConnectedError: it is not there.
            DeviceTimeoutError: it does not answer.
            DeviceProtocolError: something else answers in its place.
            MissingExtraError: the package that drives it is not installed.
        """
        if self._connected:
            return
        try:
            self._open()
        except BaseException:
            self._close()
            raise
        self._connected = True

    def disconnect(self) -> None:
        """Stop and close the device; never raises because it is gone already."""
        if not self._connected:
            return
        self.stop()
        self._connected = False
        self._close()

    def dispose(self) -> None:
        """Disconnect for good, together with whatever a simulation holds open."""
        self.disconnect()

    def stop(self) -> None:  # noqa: B027
        """End all motion; devices that move nothing have nothing to do."""

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _close(self) -> None:
        """Release what `_open` took, also after it failed half-way."""

    def _check_connected(self) -> None:
        if not self._connected:
            name = type(self).__name__
            raise DeviceNotConnectedError(f"{name} is not connected; call connect() or use a with block.")

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.disconnect()


class CameraDevice(Device):
    """A source of pictures."""

    @abstractmethod
    def read(self, timeout_s: float = 1.0) -> Frame:
        """Wait for the next picture.

        Raises:
            DeviceTimeoutError: none came within ``timeout_s``; reading may be tried again.
            DeviceNotConnectedError: the camera is gone.
            SourceAtEndError: pictures that are only played are at an end.
        """


class EmTracker(Device):
    """A source of sensor poses in the EM frame."""

    @abstractmethod
    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the next sample; raises as `CameraDevice.read` does."""


class Lamp(Device):
    """A lamp that can be dimmed."""

    @abstractmethod
    def set_level(self, level: float) -> LightSample:
        """Set the level, clamped to 0..1, and return what was really sent."""


class Gamepad(Device):
    """The operator's input device."""

    @abstractmethod
    def read(self) -> OperatorInput:
        """The state right now; never waits."""


class Output(Device):
    """Another program that is shown what happens here; what it has no use for it passes over."""

    def publish_pose(self, T_kidney_camera: NDArray[np.float64], t_wall_s: float) -> None:
        """Show the camera's pose (4, 4), mm."""

    def publish_image(self, frame: Frame) -> None:
        """Show a picture."""

    def publish_joints(self, joints: Joints, t_wall_s: float) -> None:
        """Show where the robot stands."""

    def publish_coverage(self, coverage: Mapping[str, tuple[str, float]], t_wall_s: float) -> None:
        """Show how much of every calyx was seen: verdict and share by its name."""
