"""Numbers that come from a device, checked once, before anything is computed from them.

One NaN in a TRANSFORM once froze the whole process: a singular-value decomposition that never returns holds the
interpreter, and neither watchdog nor STOP can run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ursnav_torch.devices.base import Stamp, TrackerSample, Vector3
from ursnav_torch.em_log.seen import FIELD_MM
from ursnav_torch.errors import DeviceProtocolError

#: No tracker measures farther than this; NDI's word for "no number" is -3.697314e28, others send 1e30 or -9999.
FARTHEST_MM = FIELD_MM
#: Rotations come as 32-bit floats, rounded once more by whoever passed them on.
RIGID = 1e-2


def device_number(text: str, what: str, low: float = -math.inf, high: float = math.inf) -> float:
    """A number that a device wrote as text.

    Raises:
        DeviceProtocolError: it is none, not finite, or not in ``low`` to ``high``.
    """
    try:
        value = float(text)
    except ValueError:
        raise DeviceProtocolError(f"{what} must be a number, got {text!r}; check cable and baud rate.") from None
    if not math.isfinite(value) or not low <= value <= high:
        raise DeviceProtocolError(f"{what} must be a number from {low:g} to {high:g}, got {text!r}.")
    return value


@dataclass(frozen=True, slots=True)
class SensorPose:
    """A sensor's pose in the EM frame, checked: position in mm, quaternion x y z w of length 1, axis its z axis."""

    position_mm: Vector3
    quaternion_xyzw: tuple[float, float, float, float]
    axis: Vector3

    @classmethod
    def from_matrix(cls, R: ArrayLike, position_mm: ArrayLike) -> Self | None:
        """The pose of a rotation (3, 3) and a position (3,); None for what servers send of a sensor that is not seen.

        All zero, NaN, infinite or farther than `FARTHEST_MM` mean "not seen" (PLUS, scikit-surgerynditracker, NDI).

        Raises:
            DeviceProtocolError: finite numbers that are no rotation.
        """
        R, position = np.asarray(R, float), np.asarray(position_mm, float)
        if not (np.isfinite(R).all() and _within_reach(position)) or not R.any():
            return None
        if np.abs(R).max() > 1 + RIGID or np.abs(R.T @ R - np.eye(3)).max() > RIGID or np.linalg.det(R) < 0:
            raise DeviceProtocolError(f"A tracker's rotation must be orthonormal and right-handed, got {R.tolist()}.")
        return cls._of(Rotation.from_matrix(R), position)

    @classmethod
    def from_quaternion(cls, quaternion_xyzw: ArrayLike, position_mm: ArrayLike) -> Self | None:
        """The pose of a quaternion (4,) x y z w and a position (3,); None where the sensor is not seen.

        Raises:
            DeviceProtocolError: a quaternion that is finite, not zero, and not of length 1.
        """
        q, position = np.asarray(quaternion_xyzw, float), np.asarray(position_mm, float)
        if not (np.isfinite(q).all() and _within_reach(position)) or not q.any():
            return None
        if np.abs(q).max() > 1 + RIGID or abs(float(np.linalg.norm(q)) - 1) > RIGID:
            raise DeviceProtocolError(f"A tracker's quaternion must have length 1, got {q.tolist()}.")
        return cls._of(Rotation.from_quat(q), position)

    @classmethod
    def _of(cls, rotation: Rotation, position: np.ndarray) -> Self:
        x, y, z = position.tolist()
        qx, qy, qz, qw = rotation.as_quat(canonical=True).tolist()
        ax, ay, az = rotation.apply([0.0, 0.0, 1.0]).tolist()
        return cls((x, y, z), (qx, qy, qz, qw), (ax, ay, az))


@dataclass(frozen=True, slots=True)
class Tool:
    """Which tool of a tracker a sample is of, and how many degrees of freedom it has (5: it does not know its roll)."""

    name: str
    dof: int

    def sample(
        self, stamp: Stamp, pose: SensorPose | None, source_frame: int, error_mm: float | None = None
    ) -> TrackerSample:
        """A sample of this tool; ``pose`` None where it was not seen."""
        if pose is None:
            return TrackerSample(stamp, False, dof=self.dof, tool=self.name, source_frame=source_frame)
        quaternion = pose.quaternion_xyzw if self.dof == 6 else None
        error = error_mm if error_mm is not None and math.isfinite(error_mm) else None
        return TrackerSample(
            stamp, True, pose.position_mm, pose.axis, quaternion, self.dof, self.name, source_frame, error
        )


def device_numbers(values: Sequence[object], what: str, most: int = 64) -> list[float]:
    """Numbers of a message whose types are the sender's affair; what is not finite counts as 0.

    Raises:
        DeviceProtocolError: it is no list of at most ``most`` numbers.
    """
    if not isinstance(values, list | tuple) or len(values) > most:
        raise DeviceProtocolError(f"{what} must be a list of at most {most} numbers, got {str(values)[:80]}.")
    found = [float(v) if isinstance(v, int | float) and abs(v) < 1e300 else math.nan for v in values]
    return [v if math.isfinite(v) else 0.0 for v in found]


def _within_reach(position_mm: np.ndarray) -> bool:
    """Whether a position (3,) is finite and where a tracker can measure; comparisons with NaN are false."""
    return bool((np.abs(position_mm) <= FARTHEST_MM).all())
