"""The belief over the camera's pose: what it is sure of, what it is not, and that it says so."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import check_rigid, inverse, look_along, transform_from
from ursnav_torch.tracking.belief import REGION_90, BeliefSettings, Motion, PoseBelief

SETTINGS = BeliefSettings()
START = look_along([1.0, 2.0, 3.0], [1.0, 0.4, -0.2], 0.7)
SURE = np.diag([0.2, 0.2, 0.2, 0.02, 0.02, 0.02]) ** 2


def first():
    return PoseBelief.first(START, SURE, 0.0, SETTINGS)


def moved(T, *step):
    return T @ transform_from(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3])


def test_the_spread_grows_without_evidence_and_shrinks_with_it():
    before = first()
    later = before.predicted(0.5, SETTINGS)
    assert later.position_sd_mm > 2 * before.position_sd_mm
    assert later.direction_sd_deg > before.direction_sd_deg
    seen, _ = later.updated(later.T_kidney_camera, SURE)
    assert seen.position_sd_mm < 0.21
    check_rigid(seen.T_kidney_camera, "T")


def test_a_measurement_that_leaves_depth_open_mends_what_is_aside_and_not_what_is_along():
    later = first().predicted(0.3, SETTINGS)
    tube = np.diag([0.1, 0.1, 50.0, 0.02, 0.02, 0.02]) ** 2
    seen, _ = later.updated(moved(later.T_kidney_camera, 1.0, 0.0, 1.0, 0, 0, 0), tube)
    step = (inverse(later.T_kidney_camera) @ seen.T_kidney_camera)[:3, 3]
    assert step[0] == pytest.approx(1.0, abs=0.05)
    assert abs(step[2]) < 0.05
    assert seen.covariance[0, 0] < 0.02
    assert seen.covariance[2, 2] > 0.9 * later.covariance[2, 2]


def test_a_steady_motion_is_followed_without_lag_while_the_scope_turns():
    step = transform_from(Rotation.from_rotvec([0.03, -0.02, 0.01]).as_matrix(), [0.1, 0.0, 0.8])
    T, belief = START, first()
    for n in range(1, 25):
        T = T @ step
        belief, _ = belief.predicted(0.1 * n, SETTINGS).updated(T, SURE)
    assert np.linalg.norm(belief.T_kidney_camera[:3, 3] - T[:3, 3]) < 0.1
    ahead = belief.predicted(2.5, SETTINGS)
    assert np.linalg.norm(ahead.T_kidney_camera[:3, 3] - (T @ step)[:3, 3]) < 0.2


def test_what_odometry_says_of_the_motion_keeps_the_spread_small():
    motion = Motion(np.array([0, 0, 8.0, 0, 0, 0.2]), np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]) ** 2)
    told, alone = (first().predicted(0.4, SETTINGS, m) for m in (motion, None))
    assert told.position_sd_mm < 0.5 * alone.position_sd_mm
    assert (inverse(START) @ told.T_kidney_camera)[2, 3] == pytest.approx(3.2, abs=0.3)


def test_a_measurement_far_off_counts_less_and_is_told_of():
    belief = first().predicted(0.1, SETTINGS)
    _, usual = belief.updated(moved(belief.T_kidney_camera, 0.3, 0, 0, 0, 0, 0), SURE)
    far, odd = belief.updated(moved(belief.T_kidney_camera, 30.0, 0, 0, 0, 0, 0), SURE)
    assert usual < 16.8 < odd
    went = np.linalg.norm(far.T_kidney_camera[:3, 3] - belief.T_kidney_camera[:3, 3])
    assert went < 3.0


def test_linearized_spread_agrees_with_sampled_motion():
    """The Jacobian of the step, against thousands of poses moved one by one."""
    rng = np.random.default_rng(0)
    P = np.diag([0.3, 0.3, 0.3, 0.05, 0.05, 0.05, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6]) ** 2
    twist = np.array([2.0, 0.0, 20.0, 0.3, -0.5, 0.2])
    belief = PoseBelief(START, twist, P, 0.0)
    still = BeliefSettings(push_mm_s=1e-6, swing_deg_s=1e-6)
    later = belief.predicted(0.2, still)
    errors = rng.multivariate_normal(np.zeros(6), P[:6, :6], 4000)
    step = inverse(START) @ later.T_kidney_camera
    ends = np.array([(inverse(later.T_kidney_camera) @ moved(START, *e) @ step)[:3, 3] for e in errors])
    np.testing.assert_allclose(np.cov(ends.T), later.covariance[:3, :3], atol=0.03)


def test_the_region_holds_nine_in_ten():
    belief = first().predicted(0.2, SETTINGS)
    poses = belief.drawn(3000, np.random.default_rng(1))
    away = np.linalg.norm(poses[:, :3, 3] - belief.T_kidney_camera[:3, 3], axis=1)
    assert np.mean(away <= REGION_90 * belief.position_sd_mm) == pytest.approx(0.9, abs=0.03)


def test_an_alignment_without_information_is_told_to_know_next_to_nothing():
    blind = SETTINGS.measured(np.zeros((6, 6)), 0.5)
    assert np.sqrt(blind[2, 2]) > 4.0
    along = np.diag([4e3, 4e3, 1e-3, 4e5, 4e5, 4e5])
    tube = SETTINGS.measured(along, 0.9)
    assert np.sqrt(tube[0, 0]) < 0.5 < 4.0 < np.sqrt(tube[2, 2])


def test_a_position_known_besides_draws_the_pose_there():
    belief = first().predicted(0.5, SETTINGS)
    place = belief.T_kidney_camera[:3, 3] + [0.5, 0.0, 0.0]
    seen = belief.measured_place(place, 0.05)
    assert np.linalg.norm(seen.T_kidney_camera[:3, 3] - place) < 0.05
    assert seen.position_sd_mm < 0.06


def test_settings_without_noise_are_refused():
    with pytest.raises(InputError, match="above 0"):
        BeliefSettings(fade_s=0.0)
