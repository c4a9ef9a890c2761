"""The EM sensor's verdict: the thesis's threshold, and position and direction together."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_landmarks import EM, KIDNEY

from benchmarks.shared.em import OFFSET_MM, readings, simulated_matches
from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.geometry import apply, look_along, transform_from
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.registration import (
    ErrorBudget,
    Registration,
    camera_errors,
    compare_poses,
    confusion,
    position_threshold,
    register_landmarks,
)
from ursnav_torch.vid import PlanSettings, plan_views

# Thesis table 5.2: virtual cameras in Unity coordinates (m, 6 times the phantom), the sensor in the EM frame (mm).
CAMERA_UNITY = np.array(
    [[-0.649, -0.784, -0.893], [-0.547, -0.794, -1.067], [-0.483, -0.846, -1.078], [-0.665, -0.780, -1.180],
     [-0.627, -0.777, -1.179]]
)  # fmt: skip
SENSOR_EM = np.array(
    [[-35.05, -45.62, -217.87], [-22.49, -24.2, -246.98], [-26.56, 1.59, -254.93], [-35.05, 19.42, -220.09],
     [-28.68, 14.81, -226.68]]
)  # fmt: skip
PRINTED_MM = (12.62, 14.09, 13.64, 14.50, 13.67)


@pytest.fixture(scope="module")
def thesis() -> Registration:
    return register_landmarks(EM, KIDNEY)


def identity(rng: np.random.Generator, fle_mm: float = 0.5) -> Registration:
    em = rng.normal(0, 25, (8, 3))
    return register_landmarks(em, em + rng.normal(0, fle_mm, em.shape))


def test_thesis_table_5_2_gives_the_camera_errors(thesis: Registration) -> None:
    e_cam = camera_errors(thesis, SENSOR_EM, CAMERA_UNITY * [1, 1, -1] * 1000 / 6)
    np.testing.assert_allclose(e_cam, [12.37, 14.25, 13.46, 14.03, 13.20], atol=0.005)
    assert e_cam.mean() == pytest.approx(13.46, abs=0.005)


def test_thesis_threshold_from_the_printed_errors() -> None:
    assert np.mean(PRINTED_MM) == pytest.approx(13.70, abs=0.005)
    assert np.std(PRINTED_MM, ddof=1) == pytest.approx(0.70, abs=0.015)
    assert position_threshold(PRINTED_MM, em_mm=0.7) == pytest.approx(15.10, abs=0.015)


def test_a_threshold_needs_two_errors() -> None:
    with pytest.raises(InputError, match="at least two finite reference errors"):
        position_threshold([13.0])


def test_thesis_confusion_matrix() -> None:
    right = np.repeat([True, True, False, False], [14, 1, 2, 7])
    judged = np.repeat([True, False, True, False], [14, 1, 2, 7])
    found = confusion(right, judged)
    assert (found.TP, found.FN, found.FP, found.TN) == (14, 1, 2, 7)
    assert found.balanced_accuracy == pytest.approx((14 / 15 + 7 / 9) / 2)
    assert np.isnan(confusion([True], [True]).balanced_accuracy)


def test_convention_the_offset_is_in_the_camera_frame() -> None:
    rng = np.random.default_rng(0)
    T = look_along(rng.normal(0, 10, (5, 3)), rng.normal(size=(5, 3)), rng.uniform(-1, 1, 5))
    sensor = apply(T, np.broadcast_to(OFFSET_MM, (5, 3)))
    found = compare_poses(T, sensor, T[:, :3, 2], identity(rng, 0.0), OFFSET_MM, ErrorBudget())
    np.testing.assert_allclose(found.distance_mm, 0, atol=1e-9)
    np.testing.assert_allclose(found.angle_rad, 0, atol=1e-6)
    np.testing.assert_allclose(found.p, 1, atol=1e-9)


def test_convention_the_offset_and_the_sensors_error_are_in_mm_of_the_em_frame() -> None:
    rng = np.random.default_rng(4)
    em = rng.normal(0, 25, (8, 3))
    registration = register_landmarks(em, 1.8 * em, with_scale=True)
    T = look_along(rng.normal(0, 10, (5, 3)), rng.normal(size=(5, 3)), rng.uniform(-1, 1, 5))
    sensor = apply(T, 1.8 * np.broadcast_to(OFFSET_MM, (5, 3))) / 1.8
    budget = ErrorBudget(em_mm=5.0, match_mm=1e-3, match_axis_deg=1e-3)
    found = compare_poses(T, sensor, T[:, :3, 2], registration, OFFSET_MM, budget)
    np.testing.assert_allclose(found.distance_mm, 0, atol=1e-9)
    np.testing.assert_allclose(found.expected_mm, 1.8 * 5.0, rtol=1e-3)


def test_p_values_of_right_matches_are_uniform() -> None:
    rng = np.random.default_rng(0)
    budget, offset, p = ErrorBudget(), OFFSET_MM, []
    em = rng.normal(0, 25, (8, 3))
    for _ in range(600):
        registration = register_landmarks(em, em + rng.normal(0, 1.0, em.shape))
        T = look_along(rng.normal(0, 15, (1, 3)), rng.normal(size=(1, 3)), rng.uniform(-3, 3, 1))
        turn = np.radians(budget.match_axis_deg) / 2**0.5
        E = transform_from(Rotation.from_rotvec(rng.normal(0, turn, 3)).as_matrix(), np.zeros(3))
        matched = T @ E
        matched[:, :3, 3] += rng.normal(0, budget.match_mm / 3**0.5, 3)
        sensor = apply(T[0], offset) + rng.normal(0, budget.em_mm / 3**0.5, 3)
        axis = T[0, :3, 2] + rng.normal(0, np.radians(budget.em_axis_deg) / 2**0.5, 3)
        p.append(compare_poses(matched, sensor[None], axis[None], registration, offset, budget).p[0])
    for level in (0.05, 0.2, 0.5):
        assert np.mean(np.array(p) < level) == pytest.approx(level, abs=0.05)


def test_a_sensor_without_axis_is_judged_by_position() -> None:
    rng = np.random.default_rng(1)
    T = look_along(rng.normal(0, 10, (2, 3)), rng.normal(size=(2, 3)))
    sensor = apply(T, np.broadcast_to(OFFSET_MM, (2, 3)))
    axis = np.array([[np.nan] * 3, -T[1, :3, 2]])
    found = compare_poses(T, sensor, axis, identity(rng), OFFSET_MM, ErrorBudget())
    assert found.p[0] > 0.5 and np.isnan(found.angle_rad[0])
    assert found.p[1] < 1e-6 and found.angle_rad[1] == pytest.approx(np.pi, abs=0.1)


def test_shapes_and_budgets_are_checked() -> None:
    registration = identity(np.random.default_rng(2))
    with pytest.raises(ShapeError, match="Expected poses"):
        compare_poses(np.eye(4)[None], np.zeros((2, 3)), np.zeros((2, 3)), registration, OFFSET_MM, ErrorBudget())
    with pytest.raises(InputError, match="match_mm must be positive"):
        ErrorBudget(match_mm=0)
    with pytest.raises(ShapeError, match="Reference pairs"):
        camera_errors(registration, np.zeros((3, 3)), np.zeros((2, 3)))


def test_direction_tells_matches_from_the_same_place_apart(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    plan = plan_views(phantom, phantom_lumen, PlanSettings(views_per_calyx=40, passage_views=0))
    true, matched, right = simulated_matches(phantom, plan, 600)
    rng = np.random.default_rng(3)
    registration = identity(rng)
    em, axis = readings(true, registration.T_kidney_em, rng)
    found = compare_poses(matched, em, axis, registration, OFFSET_MM, ErrorBudget())
    both = confusion(right, found.p >= 0.01)
    alone = max(confusion(right, found.distance_mm <= t).balanced_accuracy for t in np.linspace(0.5, 15, 59))
    assert both.TN + both.FP > 0.3 * 600
    assert both.balanced_accuracy >= 0.95
    assert both.balanced_accuracy > alone + 0.02
