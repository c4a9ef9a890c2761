"""What hands do: touching and looking up."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between, apply, look_along, rotation_angle
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration import RegistrationWarning, register_landmarks
from ursnav_torch.simulation import EmField
from ursnav_torch.thesis import ProtocolSettings
from ursnav_torch.thesis.touch import find_views, read_em, spread_points, touch_landmarks

EXACT = EmField(noise_mm=0.0, noise_rad=0.0, distortion_mm=0.0, seed=3)
STEADY = ProtocolSettings(hold_deg=0.0, pick_mm=0.0, em=EXACT)


def test_steady_hands_and_an_exact_tracker_give_the_trackers_frame(phantom: Kidney) -> None:
    spheres, touched = touch_landmarks(phantom, EXACT, STEADY, np.random.default_rng(0))
    found = register_landmarks(touched, spheres)
    assert found.fre_rmse_mm < 1e-6
    points = phantom.tips_mm
    np.testing.assert_allclose(found.apply(apply(EXACT.T_em_kidney, points)), points, atol=1e-6)


def test_the_sensors_center_stands_off_by_half_its_length(phantom: Kidney) -> None:
    spheres, _ = touch_landmarks(phantom, EXACT, STEADY, np.random.default_rng(0))
    points, normals = spread_points(phantom.mesh, STEADY.landmarks)
    np.testing.assert_allclose(spheres, points + STEADY.reach_mm * normals, atol=1e-9)


def test_forgetting_the_stand_off_is_noticed(phantom: Kidney) -> None:
    _, touched = touch_landmarks(phantom, EXACT, STEADY, np.random.default_rng(0))
    points, _ = spread_points(phantom.mesh, STEADY.landmarks)
    with pytest.warns(RegistrationWarning, match="fit badly"):
        assert register_landmarks(touched, points).fre_rmse_mm > 2.0


def test_noise_has_the_size_that_the_settings_say(phantom: Kidney) -> None:
    settings, rng = ProtocolSettings(reference_mm=2.0, reference_deg=4.0), np.random.default_rng(0)
    T = np.broadcast_to(look_along([1.0, 2, 3], [0.0, 1, 0]), (4000, 4, 4))
    found = find_views(T, settings, rng)
    assert np.sqrt(np.mean(np.sum((found - T)[:, :3, 3] ** 2, axis=1))) == pytest.approx(2.0, rel=0.05)
    assert np.degrees(np.sqrt(np.mean(rotation_angle(found, T) ** 2))) == pytest.approx(4.0, rel=0.05)


def test_a_reading_is_where_the_sensor_is_and_points() -> None:
    T = look_along([4.0, 5, 6], [1.0, 1, 0])
    position, axis = read_em(EXACT, T)
    np.testing.assert_allclose(position, apply(EXACT.T_em_kidney, T[:3, 3]), atol=1e-9)
    assert angle_between(axis, EXACT.T_em_kidney[:3, :3] @ T[:3, 2]) < 1e-6
    assert np.isnan(read_em(replace(EXACT, dropout=1.0), T)[0]).all()


def test_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="landmarks >= 4"):
        ProtocolSettings(landmarks=3)
    with pytest.raises(InputError, match="nearest_mm < farthest_mm"):
        ProtocolSettings(nearest_mm=12.0)
    with pytest.raises(InputError, match="must not be negative"):
        ProtocolSettings(pick_mm=-1.0)
