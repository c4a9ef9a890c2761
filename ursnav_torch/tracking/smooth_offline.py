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
from ursnav_torch.tracking.smooth import Belief, PoseFilter, SmoothSettings

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


def smooth_stretch(measured: Sequence[Measured | None], t_s: Sequence[float], settings: SmoothSettings) -> list[Array]:
    """Poses (4, 4) of one unbroken track.

    Args:
        measured: one a time, None where nothing was seen; the first is something.
        t_s: rising times in seconds.
        settings: motion and noise, lengths in mm of this kidney.
    """
    ahead, expected = PoseFilter(settings), list[Belief | None]()
    believed: list[Belief] = []
    for what, at_s in zip(measured, t_s, strict=True):
        ahead.predict(at_s)
        expected.append(ahead.belief)
        if what is not None:
            ahead.update(what.T_kidney_camera, at_s, what.score)
            for position_mm, sigma_mm in what.positions:
                ahead.measure(position_mm, sigma_mm)
        assert ahead.belief is not None, "the first of a stretch must be measured"
        believed.append(ahead.belief)
    state, R = believed[-1].state, believed[-1].R
    poses = [transform_from(R, state[0])]
    for here, after in zip(believed[-2::-1], expected[:0:-1], strict=True):
        assert after is not None
        F, _, _ = settings.motion(after.at_s - here.at_s)
        gain = here.covariance @ F.T @ np.linalg.inv(after.covariance)
        state = here.state + gain @ (state - after.state)
        turned = Rotation.from_matrix(here.R.T @ R).as_rotvec()
        R = here.R @ Rotation.from_rotvec(here.turn_variance / after.turn_variance * turned).as_matrix()
        poses.append(transform_from(R, state[0]))
    return poses[::-1]
