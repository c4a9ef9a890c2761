"""Metrics: known displacements give known errors; conventions of roll, loss and the TUM file."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.evaluation import frames_to_loss, jitter_mm, pose_errors, success, trajectory_error_mm, write_tum
from ursnav_torch.geometry import look_along, transform_from


@pytest.fixture
def true() -> np.ndarray:
    rng = np.random.default_rng(0)
    return look_along(rng.normal(0, 20, (12, 3)), rng.standard_normal((12, 3)), rng.uniform(-3, 3, 12))


def turned(about: tuple[float, float, float], degrees: float) -> np.ndarray:
    return transform_from(Rotation.from_rotvec(np.radians(degrees) * np.array(about)).as_matrix(), np.zeros(3))


def test_known_displacements_give_known_errors(true: np.ndarray) -> None:
    errors = pose_errors(true @ transform_from(np.eye(3), [3.0, 0.0, 4.0]), true)
    np.testing.assert_allclose(errors.position_mm, 5.0)
    np.testing.assert_allclose(errors.needle_mm, 5.0)
    np.testing.assert_allclose(errors.direction, 0.0, atol=1e-7)
    np.testing.assert_allclose(errors.roll, 0.0, atol=1e-7)
    errors = pose_errors(true @ turned((0, 1, 0), 60.0), true, needle_mm=20.0)
    np.testing.assert_allclose(errors.direction, np.radians(60))
    np.testing.assert_allclose(errors.needle_mm, 20.0)  # an equilateral triangle
    np.testing.assert_allclose(errors.roll, 0.0, atol=1e-7)


def test_roll_is_what_is_left_once_the_axes_agree(true: np.ndarray) -> None:
    for tilt in (0.0, 25.0, 110.0):
        errors = pose_errors(true @ turned((0.6, 0.8, 0.0), tilt) @ turned((0, 0, 1), -35.0), true)
        np.testing.assert_allclose(errors.roll, np.radians(35.0))
        np.testing.assert_allclose(errors.direction, np.radians(tilt), atol=1e-7)


def test_errors_are_the_same_in_every_frame(true: np.ndarray) -> None:
    estimated = true @ turned((0, 0.6, 0.8), 20.0) @ transform_from(np.eye(3), [1.0, 2.0, 0.5])
    here, there = pose_errors(estimated, true), pose_errors(true[0] @ estimated, true[0] @ true)
    for name in ("position_mm", "direction", "roll", "needle_mm"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), atol=1e-9)


def test_a_track_counts_its_unknown_frames_as_lost(true: np.ndarray) -> None:
    estimated = true.copy()
    estimated[:, 0, 3] += [0, 0, 7, np.nan, 0, 0, 0, 0, 12, 4, 4, 4]
    estimated[3] = np.nan
    errors = pose_errors(estimated, true)
    assert success(errors, 5.0) == pytest.approx(9 / 12)
    assert success(errors, 10.0) == pytest.approx(10 / 12)
    assert frames_to_loss(errors) == pytest.approx((3 + 4 + 3) / 3)
    assert trajectory_error_mm(errors) == pytest.approx(np.sqrt((49 + 144 + 3 * 16) / 11))
    assert jitter_mm(estimated, true) == pytest.approx((7 + 12 + 8) / 9)


def test_a_track_without_any_estimate_has_no_errors_but_is_lost(true: np.ndarray) -> None:
    errors = pose_errors(np.full_like(true, np.nan), true)
    assert success(errors, 10.0) == 0.0
    assert frames_to_loss(errors) == 0.0
    assert np.isnan(trajectory_error_mm(errors))
    assert np.isnan(jitter_mm(np.full_like(true, np.nan), true))


def test_the_tum_file_has_seconds_meters_and_xyzw(true: np.ndarray, tmp_path: Path) -> None:
    T = true.copy()
    T[4] = np.nan
    write_tum(tmp_path / "track.tum", np.arange(12) / 10, T)
    table = np.loadtxt(tmp_path / "track.tum")
    known = np.arange(12) != 4
    np.testing.assert_allclose(table[:, 0], np.arange(12)[known] / 10)
    np.testing.assert_allclose(1000 * table[:, 1:4], true[known, :3, 3], atol=1e-5)
    np.testing.assert_allclose(Rotation.from_quat(table[:, 4:]).as_matrix(), true[known, :3, :3], atol=1e-7)


def test_what_cannot_be_compared_is_refused(true: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(ShapeError, match="alike"):
        pose_errors(true[:3], true)
    with pytest.raises(InputError, match="not orthonormal"):
        pose_errors(2 * true, true)
    with pytest.raises(ShapeError, match="times"):
        write_tum(tmp_path / "x.tum", [0.0], true)
    with pytest.raises(InputError, match="finite"):
        write_tum(tmp_path / "x.tum", np.full(12, np.nan), true)
