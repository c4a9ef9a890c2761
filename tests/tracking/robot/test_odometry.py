"""The robot's word as motion: the segment's kinematics, plays that are learned, and what is left unsure."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import inverse, look_along, transform_from
from ursnav_torch.kinematics import Segment
from ursnav_torch.scaling import scaled
from ursnav_torch.tracking.robot.odometry import STILL, Carried, Odometry, OdometryReading, OdometrySettings, PlayBank
from ursnav_torch.tracking.smooth import PoseFilter

SEGMENT = Segment()


def test_pushing_a_bent_scope_drives_it_along_its_curve() -> None:
    odometry = Odometry(OdometrySettings(insertion_plays_mm=(0.0,), bend_plays_deg=(0.0,)))
    odometry.carried(OdometryReading(0.0), 0.1)
    odometry.carried(OdometryReading(0.0, 0.8), 0.1)
    carried = odometry.carried(OdometryReading(2.0, 0.8), 0.5)
    step = inverse(SEGMENT.point_transform([0.8, 0])) @ SEGMENT.point_transform([0.8, 0], 22.0)
    np.testing.assert_allclose(carried.T_before_now, step, atol=1e-6)
    assert carried.seconds == 0.5


def test_a_play_swallows_the_first_of_the_way_back() -> None:
    bank = PlayBank([2.0], 0.1)
    assert [bank.step(m)[0] for m in (0.0, 3.0, 2.0, 0.0)] == pytest.approx([0.0, 2.0, 0.0, -1.0])


def test_the_width_of_a_play_is_learned_from_what_is_seen() -> None:
    bank, true = PlayBank([0.0, 1.0, 2.0, 4.0], 0.1), PlayBank([2.0], 0.1)
    for motor in np.concatenate([np.arange(0, 6, 0.5), np.arange(6, 0, -0.5), np.arange(0, 6, 0.5)]):
        bank.step(motor)
        bank.learn(true.step(motor)[0], 0.1, 0.99)
    assert bank.weight()[2] > 0.9 and bank.width() == pytest.approx(2.0, abs=0.3)


def test_plays_that_disagree_leave_the_motion_unsure() -> None:
    """Right after a turn of direction nobody knows whether the tip has followed yet."""
    odometry = Odometry()
    for insertion in (0.0, 5.0):
        odometry.carried(OdometryReading(insertion), 0.1)
    on = odometry.carried(OdometryReading(6.0), 0.1)
    back = odometry.carried(OdometryReading(5.0), 0.1)
    assert back.sd_mm > on.sd_mm
    assert -1.0 < back.T_before_now[2, 3] < 0.0


def test_a_camera_that_is_rolled_against_the_cables_is_found_out() -> None:
    odometry, roll = Odometry(), 1.1
    R = transform_from(Rotation.from_rotvec([0, 0, roll]).as_matrix(), np.zeros(3))
    odometry.carried(OdometryReading(0.0), 0.1)
    before = np.zeros(2)
    for k in range(1, 80):
        bend = 0.5 * np.array([np.sin(k / 4), np.cos(k / 4) - 1])
        odometry.carried(OdometryReading(0.0, *bend), 0.1)
        step = inverse(SEGMENT.point_transform(before)) @ SEGMENT.point_transform(bend)
        odometry.learn(R @ step @ inverse(R), 0.1, 0.01, 0.1)
        before = bend
    assert odometry.roll() == pytest.approx(roll, abs=0.2)


def test_steps_add_up_and_so_does_what_is_not_known() -> None:
    """Steps are of the camera, so that a later one goes where the earlier one turned to."""
    turned = transform_from(Rotation.from_rotvec([0.5, 0, 0]).as_matrix(), [0.0, 0.0, 1.0])
    both = STILL.then(Carried(turned, 0.3, 0.1, 0.1)).then(Carried(turned, 0.4, 0.1, 0.2))
    np.testing.assert_allclose(both.T_before_now, turned @ turned, atol=1e-12)
    assert both.sd_mm == pytest.approx(0.7) and both.sd_rad == pytest.approx(0.2)
    assert both.seconds == pytest.approx(0.3)


@pytest.mark.parametrize("rate_hz", [5.0, 30.0, 60.0])
def test_what_is_not_known_after_a_second_does_not_depend_on_the_rate_of_pictures(rate_hz: float) -> None:
    odometry, far = Odometry(OdometrySettings(insertion_plays_mm=(0.0,), bend_plays_deg=(0.0,))), STILL
    odometry.carried(OdometryReading(0.0), 1 / rate_hz)
    for n in range(round(rate_hz)):
        far = far.then(odometry.carried(OdometryReading(4.0 * (n + 1) / rate_hz), 1 / rate_hz))
    assert far.T_before_now[2, 3] == pytest.approx(4.0) and 2.4 < far.sd_mm < 3.2


def test_a_smoothed_pose_goes_where_the_robot_carried_it() -> None:
    T = look_along(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    smooth = PoseFilter()
    smooth.update(T, 0.0, 0.9)
    step = transform_from(Rotation.from_rotvec([0.3, 0, 0]).as_matrix(), [0.0, 0.0, 2.0])
    moved = smooth.predict(0.5, Carried(step, 0.2, 0.05, 0.5))
    assert moved is not None
    np.testing.assert_allclose(moved, T @ step, atol=1e-9)


def test_plays_may_come_as_lists_and_a_larger_kidney_enlarges_no_robot() -> None:
    settings, own = scaled(OdometrySettings(insertion_plays_mm=[0, 1]), 1.8), OdometrySettings()  # type: ignore[arg-type]
    assert settings.insertion_plays_mm == (0.0, 1.0) and settings.bend_plays_deg == own.bend_plays_deg
    assert settings.length_mm == own.length_mm and settings.insertion_mm_s == pytest.approx(1.8 * own.insertion_mm_s)


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError, match="below 0"):
        OdometrySettings(insertion_plays_mm=(-1.0,))
    with pytest.raises(InputError, match="above 0"):
        OdometrySettings(memory_s=0.0)
