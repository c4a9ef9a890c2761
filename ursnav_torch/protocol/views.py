"""Poses as a scope holds its camera: a shaft that bends but does not twist fixes the roll of the picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.protocol.settings import ProtocolSettings
from ursnav_torch.vid import CollectedViews, Plan, PlanSettings, plan_views


def as_scope_holds(T_kidney_camera: Array, kidney: Kidney, lumen: LumenDistance, T_kidney_start: Array) -> Array:
    """The same places and directions (N, 4, 4), rolled as a scope's camera is that came there from its start.

    The frame is carried along the centerline by the smallest turns (parallel transport), as by a shaft of two bends
    without twist.

    Args:
        T_kidney_camera: (N, 4, 4).
        kidney, lumen: where.
        T_kidney_start: (4, 4) the withdrawn camera.
    """
    T = np.array(T_kidney_camera, float)
    calyx = observed_calyx(T, kidney, lumen)
    tree = kidney.centerline
    for i, c in enumerate(np.where(calyx < 0, lumen.to_calyces(T[:, :3, 3]).argmin(axis=1), calyx)):
        path = tree.path_to(int(c))
        here = int(np.linalg.norm(tree.points_mm[path] - T[i, :3, 3], axis=1).argmin())
        R = T_kidney_start[:3, :3]
        for direction in (*tree.tangents(path)[: here + 1], T[i, :3, 2]):
            R = smallest_turn(R[:, 2], direction) @ R
        T[i, :3, :3] = R
    return T


def smallest_turn(a: Array, b: Array) -> Array:
    """The rotation (3, 3) by the smallest angle that takes unit vector ``a`` (3,) to ``b`` (3,)."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        axis, sine = np.cross(a, np.eye(3)[np.abs(a).argmin()]), 0.0
    axis = axis / np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(axis * np.arctan2(sine, float(a @ b))).as_matrix())


def hand_collected(views: PlanSettings, kidney: Kidney, lumen: LumenDistance, T_kidney_start: Array) -> CollectedViews:
    """Planned views at the roll that the scope will have, as the thesis's were flown by hand (§3.4)."""
    plan = plan_views(kidney, lumen, views)
    T = as_scope_holds(plan.T_kidney_camera, kidney, lumen, T_kidney_start)
    return CollectedViews((), T, None, Path("views collected by hand"))


def simulation_poses(
    settings: ProtocolSettings, kidney: Kidney, lumen: LumenDistance, T_kidney_start: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Poses (N, 4, 4) of the simulation pictures and the calyx (N,) that each observes (thesis §4.1)."""
    plan: Plan = plan_views(kidney, lumen, picture_plan(settings))
    return as_scope_holds(plan.T_kidney_camera, kidney, lumen, T_kidney_start), plan.calyx


def picture_plan(settings: ProtocolSettings) -> PlanSettings:
    """Where the simulation pictures are taken from."""
    return replace(
        PlanSettings(views_per_calyx=settings.pictures_per_calyx, passage_views=0, seed=settings.seed + 2),
        nearest_mm=settings.nearest_mm,
        farthest_mm=settings.farthest_mm,
        tilt_deg=settings.tilt_deg,
    )
