"""Poses as a scope holds its camera: a shaft that bends but does not twist fixes the roll of the picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.thesis.settings import ProtocolSettings
from ursnav_torch.vid import CollectedViews, Plan, PlanSettings, plan_views


def as_scope_holds(T_kidney_camera: Array, T_kidney_start: Array) -> Array:
    """The same places and directions (N, 4, 4), rolled as a scope's camera is that came there from its start (4, 4).

    Bending turns a tip by the smallest angle to where it looks; on its way through a kidney a scope without twist ends
    up within 20 degrees of the one smallest turn from its start.
    """
    T = np.array(T_kidney_camera, float)
    for pose in T:
        pose[:3, :3] = smallest_turn(T_kidney_start[:3, 2], pose[:3, 2]) @ T_kidney_start[:3, :3]
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
    """Planned views at the roll that the scope will have, as the thesis's were flown by hand (§3.4).

    ``T_kidney_start`` (4, 4) is where it starts; see `as_scope_holds`.
    """
    plan = plan_views(kidney, lumen, views)
    T = as_scope_holds(plan.T_kidney_camera, T_kidney_start)
    return CollectedViews((), T, None, Path("views collected by hand"))


def simulation_poses(
    settings: ProtocolSettings, kidney: Kidney, lumen: LumenDistance, T_kidney_start: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Poses (N, 4, 4) of the simulation pictures and the calyx (N,) that each observes (thesis §4.1)."""
    plan: Plan = plan_views(kidney, lumen, picture_plan(settings))
    return as_scope_holds(plan.T_kidney_camera, T_kidney_start), plan.calyx


def picture_plan(settings: ProtocolSettings) -> PlanSettings:
    """Where the simulation pictures are taken from."""
    return replace(
        PlanSettings(views_per_calyx=settings.pictures_per_calyx, passage_views=0, seed=settings.seed + 2),
        nearest_mm=settings.nearest_mm,
        farthest_mm=settings.farthest_mm,
        tilt_deg=settings.tilt_deg,
    )
