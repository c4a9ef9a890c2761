"""The robot's drive in simulated time, and the pictures that an operator takes on it."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.simulation import World, make_twin
from ursnav_torch.thesis import ProtocolSettings
from ursnav_torch.thesis.drive import KEEP_EVERY, RATE_HZ, RobotDrive, choose_pictures, drive_robot

SETTINGS = ProtocolSettings()


@pytest.fixture(scope="module")
def drive(phantom: Kidney, phantom_lumen: LumenDistance, renderer: RaycastRenderer) -> RobotDrive:
    return drive_robot(make_twin(World(phantom, renderer, phantom_lumen)), phantom, SETTINGS)


def test_reaches_the_calyces_inside_the_lumen_and_within_its_speed(
    drive: RobotDrive, phantom: Kidney, phantom_lumen: LumenDistance
) -> None:
    assert set(drive.visited) == {c.name for c in phantom.calyces}
    T = drive.T_kidney_camera
    assert phantom_lumen.clearance_mm(T[:, :3, 3]).min() > 0.4
    np.testing.assert_allclose(np.diff(drive.t_s), KEEP_EVERY / RATE_HZ)
    turn = angle_between(T[1:, :3, 2], T[:-1, :3, 2]) / np.diff(drive.t_s)
    assert np.median(turn) <= SETTINGS.limits.max_bend_rate_rad_s


def test_the_same_drive_twice(
    drive: RobotDrive, phantom: Kidney, phantom_lumen: LumenDistance, renderer: RaycastRenderer
) -> None:
    again = drive_robot(make_twin(World(phantom, renderer, phantom_lumen)), phantom, SETTINGS)
    np.testing.assert_array_equal(again.T_kidney_camera, drive.T_kidney_camera)


def test_pictures_show_their_calyx_from_the_right_distance(
    drive: RobotDrive, phantom: Kidney, phantom_lumen: LumenDistance
) -> None:
    rows, calyx = choose_pictures(drive, phantom, phantom_lumen, SETTINGS)
    T = drive.T_kidney_camera[rows]
    np.testing.assert_array_equal(observed_calyx(T, phantom, phantom_lumen), calyx)
    away = phantom_lumen.to_calyces(T[:, :3, 3])[np.arange(len(rows)), calyx]
    assert away.min() >= SETTINGS.nearest_mm and away.max() <= SETTINGS.farthest_mm
    assert np.bincount(calyx).max() == SETTINGS.pictures_per_calyx and len(set(rows.tolist())) == len(rows)
    for c in set(calyx.tolist()):
        assert np.all(np.diff(away[calyx == c]) <= 0), "from far to near"


def test_a_strict_operator_takes_better_aimed_pictures(
    drive: RobotDrive, phantom: Kidney, phantom_lumen: LumenDistance
) -> None:
    def aside(aim_deg: float) -> float:
        rows, calyx = choose_pictures(drive, phantom, phantom_lumen, replace(SETTINGS, aim_deg=aim_deg))
        T = drive.T_kidney_camera[rows]
        return float(angle_between(phantom.tips_mm[calyx] - T[:, :3, 3], T[:, :3, 2]).mean())

    assert aside(10.0) < aside(60.0)
