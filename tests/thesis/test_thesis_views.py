"""Poses as a scope holds its camera."""

import numpy as np
import pytest

from ursnav_torch.geometry import Array, angle_between, look_along, rotation_angle
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.simulation import Scope, World, make_twin
from ursnav_torch.thesis import ProtocolSettings
from ursnav_torch.thesis.drive import drive_robot
from ursnav_torch.thesis.views import as_scope_holds, hand_collected, picture_plan, smallest_turn
from ursnav_torch.vid import plan_views


@pytest.mark.parametrize("b", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [1.0, 0.0, 0.0]])
def test_smallest_turn_takes_a_to_b_and_turns_no_farther(b: list[float]) -> None:
    a, b = np.array([0.0, 0.0, 1.0]), np.array(b)
    R = smallest_turn(a, b)
    np.testing.assert_allclose(R @ a, b, atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    T, eye = np.eye(4), np.eye(4)
    T[:3, :3] = R
    assert rotation_angle(eye, T) == pytest.approx(angle_between(a, b), abs=1e-6)


def start(kidney: Kidney) -> Array:
    root = kidney.centerline.points_mm[0]
    return look_along(root, kidney.tips_mm.mean(axis=0) - root)


def test_only_the_roll_changes(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    plan = plan_views(phantom, phantom_lumen, picture_plan(ProtocolSettings()))
    held = as_scope_holds(plan.T_kidney_camera, start(phantom))
    np.testing.assert_array_equal(held[:, :3, 3], plan.T_kidney_camera[:, :3, 3])
    np.testing.assert_allclose(held[:, :3, 2], plan.T_kidney_camera[:, :3, 2], atol=1e-12)
    collected = hand_collected(picture_plan(ProtocolSettings()), phantom, phantom_lumen, start(phantom))
    np.testing.assert_array_equal(collected.plan(phantom, phantom_lumen).calyx, plan.calyx)


def test_the_roll_is_the_twins_own(phantom: Kidney, phantom_lumen: LumenDistance, renderer: RaycastRenderer) -> None:
    """The twin bends its shaft step by step; the short cut comes to about the same roll."""
    twin = make_twin(World(phantom, renderer, phantom_lumen), Scope())
    drive = drive_robot(twin, phantom, ProtocolSettings())
    T = drive.T_kidney_camera
    held = as_scope_holds(T, start(phantom))
    upright = look_along(T[:, :3, 3], T[:, :3, 2])
    ours, theirs = (np.degrees(np.percentile(rotation_angle(x, T), 95)) for x in (held, upright))
    assert ours < 10 and ours < theirs / 2
