"""Rigid transforms, quaternions and axis conventions, written down once.

``T_a_b`` maps coordinates of frame b into frame a: ``p_a = T_a_b @ p_b`` and ``T_a_c = T_a_b @ T_b_c``.
All arrays are numpy, float64, lengths in mm, quaternions in the order x, y, z, w.
Camera axes are OpenCV's: x right, y down, z forward.
"""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError, ShapeError

Array = NDArray[np.float64]

#: OpenGL camera coordinates (x right, y up, looking along -z) <- OpenCV camera coordinates; its own inverse.
T_OPENGL_OPENCV: Array = np.diag([1.0, -1.0, -1.0, 1.0])
#: RAS <- LPS patient coordinates; its own inverse.
T_RAS_LPS: Array = np.diag([-1.0, -1.0, 1.0, 1.0])


def transform_from(R: ArrayLike, t_mm: ArrayLike) -> Array:
    """Join rotations (..., 3, 3) and translations (..., 3) in mm to transforms (..., 4, 4)."""
    R, t = np.asarray(R, float), np.asarray(t_mm, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def transform_from_quaternion(t_mm: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """Transforms (..., 4, 4) from translations (..., 3) in mm and quaternions (..., 4), x y z w.

    Raises:
        InputError: a quaternion is zero or not finite.
    """
    q = np.asarray(quaternion_xyzw, float)
    norm = np.linalg.norm(q, axis=-1)
    if not np.all(np.isfinite(norm)) or np.any(norm < 1e-9):
        raise InputError("A quaternion is zero or not finite; expected x, y, z, w with length 1.")
    return transform_from(Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3), t_mm)


def quaternion_from_transform(T: ArrayLike) -> Array:
    """Quaternions (..., 4), x y z w with w >= 0, of transforms (..., 4, 4)."""
    T = np.asarray(T, float)
    q = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat(canonical=True)
    return q.reshape(*T.shape[:-2], 4)


def turned_by(rotvecs: ArrayLike) -> Array:
    """Rotations (N, 3, 3) by rotation vectors (N, 3), radians about the axis.

    OpenCV's, one by one: SciPy's checks take longer than the turning of a few.
    """
    turns = [cv2.Rodrigues(v)[0] for v in np.asarray(rotvecs, float).reshape(-1, 3)]
    return np.array(turns, float).reshape(-1, 3, 3)


def inverse(T_a_b: ArrayLike) -> Array:
    """``T_b_a`` (..., 4, 4) of rigid transforms ``T_a_b`` (..., 4, 4)."""
    T = np.asarray(T_a_b, float)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform_from(Rt, -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3]))


def apply(T_a_b: ArrayLike, p_b: ArrayLike) -> Array:
    """Points (..., 3) of frame b in frame a; ``T_a_b`` is one transform (4, 4) or one a point (..., 4, 4)."""
    T, p = np.asarray(T_a_b, float), np.asarray(p_b, float)
    if T.shape[-2:] != (4, 4) or p.shape[-1:] != (3,):
        raise ShapeError(f"Expected transforms (..., 4, 4) and points (..., 3), got {T.shape} and {p.shape}.")
    if T.ndim == 2:
        return p @ T[:3, :3].T + T[:3, 3]
    return np.einsum("...ij,...j->...i", T[..., :3, :3], p) + T[..., :3, 3]


def check_rigid(T: ArrayLike, name: str) -> Array:
    """Return ``T`` (..., 4, 4) as float64.

    Raises:
        ShapeError: not (..., 4, 4).
        InputError: not finite, or its rotation is not orthonormal and right-handed to 1e-3.
    """
    T = np.asarray(T, float)
    if T.shape[-2:] != (4, 4):
        raise ShapeError(f"{name} must have shape (..., 4, 4), got {T.shape}.")
    R = T[..., :3, :3]
    if not np.all(np.isfinite(T)) or np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0) > 1e-3:
        raise InputError(f"{name} is not a rigid transform: its 3x3 part is not orthonormal.")
    if np.any(np.linalg.det(R) < 0):
        raise InputError(f"{name} mirrors space (determinant -1); convert left-handed poses first.")
    return T


def look_along(position_mm: ArrayLike, direction: ArrayLike, roll: ArrayLike = 0.0) -> Array:
    """``T_kidney_camera`` (..., 4, 4) of cameras at positions (..., 3) that look along directions (..., 3).

    At zero roll the image's up is as near to the kidney's +z as the direction allows (to +y where the view is
    within 2.6 degrees of the z axis); ``roll`` (radians) then turns the camera about its optical axis,
    x towards y.
    """
    position, z = np.asarray(position_mm, float), np.asarray(direction, float)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    up = np.where(np.abs(z[..., 2:]) < 0.999, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    x = np.cross(z, up)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = np.cross(z, x)
    c, s = np.cos(roll)[..., None], np.sin(roll)[..., None]
    return transform_from(np.stack(np.broadcast_arrays(c * x + s * y, c * y - s * x, z), axis=-1), position)


def rotation_angle(T_a_b: ArrayLike, T_a_c: ArrayLike) -> Array:
    """Angle in radians (...) between the rotations of two batches of transforms (..., 4, 4)."""
    R = np.swapaxes(np.asarray(T_a_b, float)[..., :3, :3], -1, -2) @ np.asarray(T_a_c, float)[..., :3, :3]
    return np.arccos(np.clip((np.trace(R, axis1=-2, axis2=-1) - 1) / 2, -1, 1))


def angle_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Angle in radians (...) between vectors (..., 3)."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def transform_from_unity(position: ArrayLike, quaternion_xyzw: ArrayLike, mm_per_unit: float) -> Array:
    """``T_kidney_camera`` (..., 4, 4) of Unity cameras: left-handed, y up, looking along +z.

    With ``M = diag(1, 1, -1)``: ``p = mm_per_unit * M p'`` and the quaternion (x, y, z, w) becomes
    (-x, -y, z, w), an OpenGL camera, which the last factor turns into OpenCV's axes. The thesis enlarged
    anatomy 10.8 times in a world of meters (§3.3.2), so anatomical mm are ``mm_per_unit = 1000 / 10.8``.
    """
    p, q = np.asarray(position, float), np.asarray(quaternion_xyzw, float)
    flip_q, flip_p = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])
    return transform_from_quaternion(mm_per_unit * p * flip_p, q * flip_q) @ T_OPENGL_OPENCV


def transform_to_unity(T_kidney_camera: ArrayLike, mm_per_unit: float) -> tuple[Array, Array]:
    """Positions (..., 3) and quaternions (..., 4), x y z w, for Unity; the inverse of `transform_from_unity`."""
    T = np.asarray(T_kidney_camera, float) @ T_OPENGL_OPENCV
    flip_q, flip_p = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])
    return T[..., :3, 3] * flip_p / mm_per_unit, quaternion_from_transform(T) * flip_q


def hemisphere(count: int) -> Array:
    """(N, 3) unit vectors, evenly spread over half a sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z = k / count
    angle = np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
