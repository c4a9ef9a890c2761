"""Flights of the scope for the tests of whatever follows it."""

import numpy as np

from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney
from ursnav_torch.vid import Vid


def flight(
    kidney: Kidney, calyx: int, *, from_mm: float = 14.0, to_mm: float = 4.0, step_mm: float = 0.8, roll: float = 0.0
) -> np.ndarray:
    """T_kidney_camera (N, 4, 4) in along the centerline, looking ahead.

    Args:
        kidney: in whose lumen.
        calyx: index of the calyx flown to.
        from_mm, to_mm: the flight begins and ends this far before the calyx's end of the centerline.
        step_mm: from one pose to the next.
        roll: radians that the camera has rolled by at the end, evenly.
    """
    points = kidney.centerline.points_mm[kidney.centerline.path_to(calyx)]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    stations = np.arange(along[-1] - from_mm, along[-1] - to_mm, step_mm)
    at, ahead = (np.stack([np.interp(stations + d, along, points[:, i]) for i in range(3)], 1) for d in (0, 4))
    return look_along(at, ahead - at, np.linspace(0, roll, len(stations)))


def hover(vid: Vid, calyx: int, pictures: int) -> np.ndarray:
    """T_kidney_camera (N, 4, 4) of a scope that hovers before a calyx, at the first of its views."""
    start = vid.T_kidney_camera[np.flatnonzero(vid.calyx == calyx)[0]]
    way = vid.kidney.tips_mm[calyx] - start[:3, 3]
    poses = np.repeat(start[None], pictures, axis=0)
    poses[:, :3, 3] += 0.15 * np.sin(np.arange(pictures) / 3)[:, None] * way / np.linalg.norm(way)
    return poses


def ahead_by(T_kidney_camera: np.ndarray, mm: float) -> np.ndarray:
    """Poses (..., 4, 4) moved along the camera's own axis."""
    moved = T_kidney_camera.copy()
    moved[..., :3, 3] += mm * T_kidney_camera[..., :3, 2]
    return moved
