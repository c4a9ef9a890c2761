"""What the motion model holds probable, and what smoothing does to a track."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along, rotation_angle
from ursnav_torch.scaling import scaled
from ursnav_torch.tracking.motion import Hypotheses, MotionSettings, transition
from ursnav_torch.tracking.smooth import PoseFilter, SmoothSettings


def at(x: float, turn: float = 0.0) -> np.ndarray:
    return look_along(np.array([x, 0.0, 0.0]), np.array([np.cos(turn), np.sin(turn), 0.0]))


def here(to_tips: list[float]) -> Hypotheses:
    return Hypotheses(at(0.0)[None], np.array([to_tips]), np.ones(1))


def log(T: list[np.ndarray], to_tips: list[list[float]], seconds: float = 0.1, unit: float = 1.0) -> np.ndarray:
    return transition(here([10.0]), np.array(T), np.array(to_tips), seconds, scaled(MotionSettings(), unit))


def test_the_farther_and_the_more_turned_the_less_probable() -> None:
    p = log([at(0), at(1), at(3), at(30), at(1, 0.5)], [[10.0], [10.0], [10.0], [10.0], [10.0]])
    assert p[0] > p[1] > p[2] > p[3]
    assert p[4] < p[1]


def test_through_a_wall_is_as_far_as_around_it() -> None:
    through, along = log([at(1), at(1)], [[30.0], [11.0]])
    assert through < along - 3


def test_more_time_lets_the_scope_go_farther_and_jumps_are_never_impossible() -> None:
    quick, slow = (log([at(5), at(0)], [[10.0], [10.0]], seconds) for seconds in (0.1, 1.0))
    assert slow[0] - slow[1] > quick[0] - quick[1]
    near, far, farther = log([at(0), at(1e4), at(1e5)], [[10.0], [1e4], [1e5]])
    assert near - 25 < far == pytest.approx(farther)  # the floor: 0.02 a second, one place and direction of 1e5


def test_a_larger_phantom_is_larger_in_every_step() -> None:
    once = transition(here([10.0]), at(1)[None], np.array([[11.0]]), 0.1, MotionSettings())
    twice = transition(here([20.0]), at(2)[None], np.array([[22.0]]), 0.1, scaled(MotionSettings(), 2.0))
    np.testing.assert_allclose(once, twice)


def test_smoothing_keeps_a_steady_track_and_calms_a_noisy_one() -> None:
    rng, still, noisy = np.random.default_rng(0), PoseFilter(), PoseFilter()
    for i in range(30):
        steady = still.update(at(0.5 * i), i / 10, 0.8)
        shaken = at(0.5 * i)
        shaken[:3, 3] += rng.normal(0, 0.4, 3)
        calmed = noisy.update(shaken, i / 10, 0.8)
    assert np.linalg.norm(steady[:3, 3] - at(14.5)[:3, 3]) < 0.15
    assert np.linalg.norm(calmed[:3, 3] - at(14.5)[:3, 3]) < 0.7
    np.testing.assert_allclose(calmed[:3, :3] @ calmed[:3, :3].T, np.eye(3), atol=1e-9)


def test_rotation_is_smoothed_too_and_follows_a_steady_turn() -> None:
    rng, still, turning = np.random.default_rng(1), PoseFilter(), PoseFilter()
    axis, noise = np.array([0.0, 0.0, 1.0]), np.radians(rng.normal(0, 2.0, 60))
    rough, calm, behind = [], [], []
    for i in range(60):
        shaken = np.eye(4)
        shaken[:3, :3] = Rotation.from_rotvec(noise[i] * axis).as_matrix()
        rough.append(abs(noise[i]))
        calm.append(rotation_angle(still.update(shaken, i / 10, 0.8), np.eye(4)))
        steady = np.eye(4)
        steady[:3, :3] = Rotation.from_rotvec(np.radians(2.0 * i) * axis).as_matrix()  # 20 degrees a second
        behind.append(rotation_angle(turning.update(steady, i / 10, 0.8), steady))
    assert np.mean(calm[10:]) < 0.85 * np.mean(rough[10:])
    assert np.degrees(behind[-1]) < 1.5


def test_a_badly_aligned_pose_turns_the_track_less() -> None:
    turned, aside = [], np.eye(4)
    aside[:3, :3] = Rotation.from_rotvec([0.0, np.radians(20.0), 0.0]).as_matrix()
    for score in (0.8, 0.4):
        track = PoseFilter()
        for i in range(10):
            track.update(np.eye(4), i / 10, 0.8)
        turned.append(rotation_angle(track.update(aside, 1.0, score), np.eye(4)))
    assert 0 < turned[1] < 0.3 * turned[0]


def test_a_position_known_besides_draws_the_pose_as_far_as_it_is_sure() -> None:
    drawn = []
    for sigma in (0.2, 2.0):
        track = PoseFilter()
        for i in range(10):
            track.update(np.eye(4), i / 10, 0.8)
        track.measure(np.array([1.0, 0.0, 0.0]), sigma)
        drawn.append(track.pose()[0, 3])
    assert 0.3 < drawn[0] < 0.9 and 0 < drawn[1] < 0.15


def test_a_badly_aligned_pose_moves_the_track_less() -> None:
    moved = []
    for score in (0.8, 0.4):
        track = PoseFilter()
        for i in range(10):
            track.update(at(0.0), i / 10, 0.8)
        moved.append(track.update(at(2.0), 1.0, score)[0, 3])
    assert 0 <= moved[1] < 0.5 * moved[0]


def test_a_scope_that_is_not_seen_comes_to_rest() -> None:
    track = PoseFilter()
    for i in range(10):
        track.update(at(1.0 * i), i / 10, 0.8)
    a, b, c = (track.predict(t) for t in (1.0, 3.0, 6.0))
    assert a is not None and b is not None and c is not None
    assert 9.0 < a[0, 3] < b[0, 3] < 14.0
    assert c[0, 3] - b[0, 3] < 0.05
    assert PoseFilter().predict(1.0) is None


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(InputError, match="0 < jump < 1"):
        MotionSettings(jump=0.0)
    with pytest.raises(InputError, match="above 0"):
        SmoothSettings(fade_s=0.0)
