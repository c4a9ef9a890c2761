"""The robot's word as motion: the segment's kinematics, plays that are learned, and what is left unsure."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.kinematics import Segment
from ursnav_torch.scaling import scaled
from ursnav_torch.tracking.odometry import Odometry, OdometryReading, OdometrySettings, PlayBank

SEGMENT = Segment()


def test_pushing_a_bent_scope_drives_it_along_its_curve():
    odometry = Odometry(OdometrySettings(insertion_plays_mm=(0.0,), bend_plays_deg=(0.0,)))
    odometry.motion(OdometryReading(0.0), 0.1)
    odometry.motion(OdometryReading(0.0, 0.8), 0.1)
    motion = odometry.motion(OdometryReading(2.0, 0.8), 0.5)
    step = inverse(SEGMENT.point_transform([0.8, 0])) @ SEGMENT.point_transform([0.8, 0], 22.0)
    np.testing.assert_allclose(motion.twist[:3] * 0.5, step[:3, 3], atol=1e-6)
    np.testing.assert_allclose(motion.twist[3:] * 0.5, Rotation.from_matrix(step[:3, :3]).as_rotvec(), atol=1e-6)


def test_a_play_swallows_the_first_of_the_way_back():
    bank = PlayBank([2.0], 0.1)
    assert [bank.step(m)[0] for m in (0.0, 3.0, 2.0, 0.0)] == pytest.approx([0.0, 2.0, 0.0, -1.0])


def test_the_width_of_a_play_is_learned_from_what_is_seen():
    bank, true = PlayBank([0.0, 1.0, 2.0, 4.0], 0.1), PlayBank([2.0], 0.1)
    for motor in np.concatenate([np.arange(0, 6, 0.5), np.arange(6, 0, -0.5), np.arange(0, 6, 0.5)]):
        bank.step(motor)
        bank.learn(true.step(motor)[0], 0.1, 0.99)
    assert bank.weight()[2] > 0.9


def test_plays_that_disagree_leave_the_motion_unsure():
    odometry = Odometry()
    for insertion in (0.0, 5.0):
        odometry.motion(OdometryReading(insertion), 0.1)
    turned_back = odometry.motion(OdometryReading(4.0), 0.1)
    assert np.sqrt(turned_back.covariance[2, 2]) > 3.0  # mm/s
    assert turned_back.twist[2] > -10.0


def test_a_camera_that_is_rolled_against_the_cables_is_found_out():
    odometry, roll = Odometry(), 1.1
    R = Rotation.from_rotvec([0, 0, roll]).as_matrix()
    odometry.motion(OdometryReading(0.0), 0.1)
    before = np.zeros(2)
    for k in range(1, 80):
        bend = 0.5 * np.array([np.sin(k / 4), np.cos(k / 4) - 1])
        odometry.motion(OdometryReading(0.0, *bend), 0.1)
        step = inverse(SEGMENT.point_transform(before)) @ SEGMENT.point_transform(bend)
        turned = transform_from(R, [0, 0, 0]) @ step @ transform_from(R.T, [0, 0, 0])
        odometry.learn(np.eye(4), turned, 0.1, 0.01, 0.1)
        before = bend
    assert odometry._roll() == pytest.approx(roll, abs=0.2)


def test_plays_may_come_as_lists_and_are_lengths_of_anatomy():
    settings = scaled(OdometrySettings(insertion_plays_mm=[0, 1]), 1.8)  # type: ignore[arg-type]
    assert settings.insertion_plays_mm == (0.0, 1.8) and settings.bend_plays_deg == OdometrySettings().bend_plays_deg


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="below 0"):
        OdometrySettings(insertion_plays_mm=(-1.0,))
    with pytest.raises(InputError, match="above 0"):
        OdometrySettings(memory_s=0.0)
