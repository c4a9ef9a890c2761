"""How firmly a pose says which calyx it observes: between two that are as central, a small error names the other.

Simulated answers that are wrong though nothing speaks against them mostly have the right pose, and stand on such a
border.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import transform_from
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx

Array = NDArray[np.float64]

#: Standard deviations, along and about each axis, of the poses asked: half of them as refined poses err on clear
#: pictures, half as on poor ones; mm at the kidney's scale 1, and degrees.
ERRORS = ((0.4, 2.5), (1.2, 7.0))
#: Poses asked with each of them.
POSES = 48


def label_shares(T_kidney_camera: Array, kidney: Kidney, lumen: LumenDistance) -> Array:
    """(C + 1,) share of the poses around one (4, 4) that observe each calyx, the last of none."""
    labels = observed_calyx(T_kidney_camera @ _moves(kidney.scale), kidney, lumen)
    count = len(kidney.calyces) + 1
    return np.asarray(np.bincount(labels % count, minlength=count) / len(labels))


@lru_cache(maxsize=8)
def _moves(scale: float) -> Array:
    """The errors (2 * `POSES`, 4, 4), in the camera frame; always the same."""
    rng, moves = np.random.default_rng(0), []
    for mm, deg in ERRORS:
        R = Rotation.from_rotvec(np.radians(deg) * rng.normal(size=(POSES, 3))).as_matrix()
        moves.append(transform_from(R, mm * scale * rng.normal(size=(POSES, 3))))
    return np.concatenate(moves)
