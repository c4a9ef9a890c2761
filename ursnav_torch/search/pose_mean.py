"""What near-best hypotheses say together: the mean of those that are one place."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.geometry import transform_from

Array = NDArray[np.float64]

#: Hypotheses within this of each other are one place; mm at the kidney's scale 1, and degrees.
NEAR_MM, NEAR_DEG = 3.0, 25.0


def mean_pose(
    T_kidney_camera: Array, weight: Array, row: int, near_mm: float, near_deg: float = NEAR_DEG
) -> tuple[Array, float]:
    """The weighted mean of the poses near one of them, and their share of the weight.

    Views stand on all sides of the picture's own pose, so that their errors partly cancel.

    Args:
        T_kidney_camera: (N, 4, 4).
        weight: (N,) at least 0, above 0 at ``row``.
        row: of the pose around which is averaged.
        near_mm, near_deg: poses within both of it count.

    Returns:
        (4, 4) T_kidney_camera, and a number 0..1.
    """
    T = T_kidney_camera
    near = are_near(T, T[row], near_mm, near_deg)
    w = weight[near]
    share = w / w.sum()
    R = _nearest_rotation(np.einsum("n,nij->ij", share, T[near, :3, :3]))
    return transform_from(R, share @ T[near, :3, 3]), float(w.sum() / weight.sum())


def _nearest_rotation(M: Array) -> Array:
    """The rotation (3, 3) nearest to a matrix (3, 3): of a weighted sum of rotations, their chordal mean (Hartley et
    al., Rotation averaging, IJCV 103:267, 2013), which is that of their quaternions as well."""
    U, _, Vt = np.linalg.svd(M)
    U[:, 2] *= np.linalg.det(U @ Vt)
    return np.asarray(U @ Vt)


def are_near(T_a: Array, T_b: Array, near_mm: float, near_deg: float) -> NDArray[np.bool_]:
    """Which poses (N, 4, 4) are one place with another (4, 4): no farther away, and no farther turned."""
    near = np.linalg.norm(T_a[:, :3, 3] - T_b[:3, 3], axis=1) <= near_mm
    cosine = (np.einsum("nij,ij->n", T_a[:, :3, :3], T_b[:3, :3]) - 1) / 2
    return np.asarray(near & (cosine >= np.cos(np.radians(near_deg))), bool)
