"""How the tip of the scope moves from picture to picture: what follows from what, and with what probability."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.tracking.robot.odometry import Carried

Array = NDArray[np.float64]

#: Hypotheses that somebody may want to look at: as many as a page can draw.
PLACES = 48
#: Poses weighed at a time, so that what is made on the way stays in the second-level cache.
_AT_ONCE = 256
#: A jump's density against that of a step of no length: one place of a thousand, one direction of a hundred.
_JUMP_DENSITY = 1e-5
#: Heavy tail of the turn: what any turn is worth beside none, for a tip that is let go whirls round in one picture.
_ANY_TURN = 0.01


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Limits of the scope's motion; mm at the kidney's scale 1.

    Attributes:
        speed_mm_s: typical speed along the lumen.
        turn_deg_s: typical speed of turning, roll included.
        spacing_mm, spacing_deg: how coarse the poses compared are; a scope that stands still moves by this much
            from one to the next.
        jump: probability a second that the scope is anywhere else: a cut in the video, or a wrong track before.
    """

    speed_mm_s: float = 8.0
    turn_deg_s: float = 45.0
    spacing_mm: float = 1.0
    spacing_deg: float = 8.0
    jump: float = 0.02

    def __post_init__(self) -> None:
        if min(self.speed_mm_s, self.turn_deg_s, self.spacing_mm, self.spacing_deg) <= 0 or not 0 < self.jump < 1:
            raise InputError(f"Motion needs speeds and spacings above 0 and 0 < jump < 1, got {self}.")


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Poses that the scope may have.

    Attributes:
        T_kidney_camera: (M, 4, 4).
        to_tips_mm: (M, C) way along the lumen from each to every calyx.
        weight: (M,) probabilities, sum 1.
    """

    T_kidney_camera: Array
    to_tips_mm: Array
    weight: Array

    def carried(self, T_before_now: Array, lumen: LumenDistance) -> "Hypotheses":
        """All of them moved as the camera (4, 4) was, in its own frame."""
        T = self.T_kidney_camera @ T_before_now
        return Hypotheses(T, lumen.to_calyces(T[:, :3, 3]), self.weight)


@dataclass(frozen=True, slots=True)
class Since:
    """What was known before, and what motion may have made of it by now.

    Attributes:
        before: the hypotheses then, carried on as far as a robot told.
        seconds: that have passed.
        motion: limits of what else happened, lengths in mm of this kidney.
    """

    before: Hypotheses
    seconds: float
    motion: MotionSettings

    @classmethod
    def told(
        cls, before: Hypotheses, seconds: float, motion: MotionSettings, carried: Carried | None, lumen: LumenDistance
    ) -> "Since":
        """Where a robot told how the camera was carried, the hypotheses go along, and little else is expected."""
        if carried is None:
            return cls(before, seconds, motion)
        seconds = max(seconds, 1e-3)
        speed, turn = carried.sd_mm / seconds, float(np.degrees(carried.sd_rad)) / seconds
        less = replace(motion, speed_mm_s=max(speed, 1e-3), turn_deg_s=max(turn, 1e-3))
        return cls(before.carried(carried.T_before_now, lumen), seconds, less)

    def log_probability(self, T: Array, to_tips_mm: Array) -> Array:
        """Of poses (N, 4, 4) with their ways to the tips (N, C), see `transition`."""
        return transition(self.before, T, to_tips_mm, self.seconds, self.motion)


def likeliest_places(found: Hypotheses, count: int = PLACES) -> Array:
    """(K, 4) x, y, z in the kidney frame and probability of the likeliest hypotheses, the likeliest first."""
    first = np.argsort(-found.weight, kind="stable")[:count]
    return np.column_stack([found.T_kidney_camera[first, :3, 3], found.weight[first]])


def transition(before: Hypotheses, T: Array, to_tips_mm: Array, seconds: float, motion: MotionSettings) -> Array:
    """Log-probability (N,) of poses T (N, 4, 4) some seconds after ``before``, up to a constant.

    A heavy-tailed transition in the way along the lumen and in the turn, with the tails that views far apart and a
    scope that jerks need, mixed over the hypotheses, on a floor of jumps. The way between
    two places is at least their distance, and at least the difference of their ways to any tip (triangle inequality):
    the larger of the two keeps neighbors through a wall apart.

    Args:
        before: what was known before.
        T, to_tips_mm: poses and their ways to the tips (N, C).
        seconds: since.
        motion: limits, lengths in mm of this kidney (see `scaled`).
    """
    jump = 1 - (1 - motion.jump) ** max(seconds, 1e-3)
    reach = np.hypot(motion.spacing_mm, motion.speed_mm_s * seconds)
    spread = np.radians(np.hypot(motion.spacing_deg, motion.turn_deg_s * seconds))
    near = np.empty(len(T))
    for first in range(0, len(T), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        near[some] = _near(before, T[some], to_tips_mm[some], reach, spread)
    return np.log((1 - jump) * near + jump * _JUMP_DENSITY)


def _near(before: Hypotheses, T: Array, to_tips_mm: Array, reach: float, spread: float) -> Array:
    """How well some poses (N, 4, 4) follow from all those before (N,), jumps apart."""
    way = cdist(T[:, :3, 3], before.T_kidney_camera[:, :3, 3])
    np.maximum(way, cdist(to_tips_mm, before.to_tips_mm, "chebyshev"), out=way)
    turned = (torch.from_numpy(x[:, :3, :3].reshape(len(x), 9)) for x in (T, before.T_kidney_camera))
    trace = next(turned) @ next(turned).T  # NumPy's product would wake a second thread for each
    turn = np.arccos(np.clip((trace.numpy() - 1) / 2, -1, 1).astype(np.float32))
    near = _tail(turn, spread)
    near += np.float32(_ANY_TURN)
    near *= _tail(way.astype(np.float32), reach)
    return np.asarray(near @ before.weight.astype(np.float32), float)


def _tail(x: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """``exp(1 - sqrt(1 + (x / scale)^2))``, in place."""
    x /= np.float32(scale)
    np.square(x, out=x)
    x += 1
    np.sqrt(x, out=x)
    np.subtract(1, x, out=x)
    return np.exp(x, out=x)
