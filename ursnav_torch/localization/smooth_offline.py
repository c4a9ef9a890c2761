"""The poses of a whole stretch of pictures at once, from those before and those after: a Kalman smoother.

Position and velocity by Rauch, Tung and Striebel (AIAA Journal 3:1445, 1965), rotation by the same gains on the turn
between neighbors; the motion and its noise are those of the live filter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import transform_from
from ursnav_torch.localization.smooth import SmoothSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measured:
    """A pose (4, 4) as it was aligned with a picture, the alignment's score, and positions (3,) known besides.

    Attributes:
        T_kidney_camera: (4, 4).
        score: see `Refined`.
        positions: (position_mm, standard deviation) of other instruments.
    """

    T_kidney_camera: Array
    score: float
    positions: tuple[tuple[Array, float], ...] = ()


@dataclass(slots=True)
class _Step:
    """One time: position and velocity (2, 3), their covariance, rotation and its variance, before and after."""

    F: Array
    expected: Array
    expected_covariance: Array
    expected_turn: float
    state: Array
    covariance: Array
    R: Array
    turn: float


def smooth_stretch(
    measured: Sequence[Measured | None], t_s: Sequence[float], settings: SmoothSettings, unit: float
) -> list[Array]:
    """Poses (4, 4) of one unbroken track.

    Args:
        measured: one a time, None where nothing was seen; the first is something.
        t_s: rising times in seconds.
        settings: motion and noise.
        unit: the kidney's scale.
    """
    steps = _filtered(measured, t_s, settings, unit)
    state, R = steps[-1].state, steps[-1].R
    poses = [transform_from(R, state[0])]
    for step, after in zip(steps[-2::-1], steps[:0:-1], strict=True):
        gain = step.covariance @ after.F.T @ np.linalg.inv(after.expected_covariance)
        state = step.state + gain @ (state - after.expected)
        turned = Rotation.from_matrix(step.R.T @ R).as_rotvec()
        R = step.R @ Rotation.from_rotvec(step.turn / max(after.expected_turn, 1e-12) * turned).as_matrix()
        poses.append(transform_from(R, state[0]))
    return poses[::-1]


def _filtered(
    measured: Sequence[Measured | None], t_s: Sequence[float], settings: SmoothSettings, unit: float
) -> list[_Step]:
    """The same forward: every time's state as the measurements up to it have it."""
    first = measured[0]
    assert first is not None
    sigma, turn = settings.noise(first.score, unit)
    state = np.stack([first.T_kidney_camera[:3, 3], np.zeros(3)])
    covariance, R, variance = np.diag([sigma, 5.0 * unit]) ** 2, first.T_kidney_camera[:3, :3], turn**2
    steps = [_Step(np.eye(2), state, covariance, variance, state, covariance, R, variance)]
    for what, before_s, at_s in zip(measured[1:], t_s[:-1], t_s[1:], strict=True):
        F, push, swing = settings.motion(at_s - before_s, unit)
        expected, spread, turns = F @ state, F @ covariance @ F.T + push, variance + swing
        state, covariance, variance = expected, spread, turns
        if what is not None:
            sigma, turn = settings.noise(what.score, unit)
            for position, deviation in ((what.T_kidney_camera[:3, 3], sigma), *what.positions):
                gain = covariance[:, 0] / (covariance[0, 0] + deviation**2)
                state = state + gain[:, None] * (position - state[0])
                covariance = covariance - np.outer(gain, covariance[0])
            share = variance / (variance + turn**2)
            turned = Rotation.from_matrix(R.T @ what.T_kidney_camera[:3, :3]).as_rotvec()
            R, variance = R @ Rotation.from_rotvec(share * turned).as_matrix(), (1 - share) * variance
        steps.append(_Step(F, expected, spread, turns, state, covariance, R, variance))
    return steps
