"""Landmark registration: the thesis's printed numbers, agreement with scipy, and what it refuses."""

import warnings

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import angle_between, transform_from
from ursnav_torch.registration import RegistrationWarning, fit_rigid, register_landmarks

# Thesis table 5.1: Unity coordinates in meters at 6 times the phantom, EM coordinates in mm.
UNITY = np.array(
    [
        [-0.418, -0.813, -1.189],
        [-0.492, -0.672, -0.952],
        [-0.507, -0.795, -0.434],
        [-1.121, -0.861, -0.993],
        [-0.723, -0.887, -1.644],
        [-0.756, -0.515, -1.040],
        [-0.776, -0.594, -0.713],
        [-0.988, -1.002, -1.311],
    ]
)
EM = np.array(
    [
        [-22.80, 8.48, -274],
        [-48.66, -34.39, -255],
        [-15.28, -112.78, -234],
        [-25.25, -16.25, -149],
        [-30.20, 86.87, -228],
        [-80.90, -11.75, -216],
        [-57.46, -76.03, -205],
        [-6.80, 43.03, -175],
    ]
)
KIDNEY = UNITY * [1, 1, -1] * 1000 / 6  # Eq. 5.1: the phantom at 1.8 times anatomy, mm
R_PRINTED = np.array([[0.109, -0.118, -0.987], [-0.987, -0.134, -0.093], [-0.121, 0.984, -0.130]])
T_PRINTED = np.array([-332.0, -185.0, 153.0])


def problem(rng: np.random.Generator, n: int = 8, noise_mm: float = 0.0) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 100, 3)
    em = rng.normal(0, 30, (n, 3))
    return em, em @ R.T + t + rng.normal(0, noise_mm, (n, 3)), R, t


def test_thesis_table_5_1_gives_the_printed_transform() -> None:
    found = register_landmarks(EM, KIDNEY)
    np.testing.assert_allclose(found.R, R_PRINTED, atol=0.003)
    np.testing.assert_allclose(found.t_mm, T_PRINTED, atol=1.2)
    assert found.fre_rmse_mm == pytest.approx(5.12, abs=0.005)
    np.testing.assert_allclose(found.fre_mm, [5.73, 2.95, 6.20, 5.35, 2.33, 7.02, 6.57, 1.83], atol=0.005)
    assert found.tre_loo_rmse_mm == pytest.approx(6.72, abs=0.005)
    assert found.n == 8 and found.scale == 1.0 and not found.suspicions


def test_thesis_rmse_of_the_printed_matrices() -> None:
    residual = EM @ R_PRINTED.T + T_PRINTED - KIDNEY
    assert np.sqrt(np.mean(np.sum(residual**2, axis=1))) == pytest.approx(5.20, abs=0.005)


def test_thesis_points_with_a_forgotten_z_flip_look_mirrored() -> None:
    with pytest.warns(RegistrationWarning, match="mirrored"):
        found = register_landmarks(EM, UNITY * 1000 / 6)
    assert found.fre_rmse_mm == pytest.approx(43.9, abs=0.05)
    assert "mirrored" in found.suspicions[0]


def test_thesis_similarity_scale() -> None:
    assert register_landmarks(EM, KIDNEY, with_scale=True).scale == pytest.approx(0.990, abs=0.0005)


def test_a_thousand_problems_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(1000):
        em, kidney, *_ = problem(rng, n=rng.integers(4, 20), noise_mm=1.0)
        weights = rng.uniform(0.1, 2.0, len(em))
        found = register_landmarks(em, kidney, weights=weights)
        a, b = np.average(em, 0, weights), np.average(kidney, 0, weights)
        theirs, _ = Rotation.align_vectors(kidney - b, em - a, weights)
        np.testing.assert_allclose(found.R, theirs.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(found.t_mm, b - theirs.apply(a), atol=1e-7)


def test_batches_equal_single_fits() -> None:
    rng = np.random.default_rng(1)
    source, target = torch.from_numpy(rng.normal(size=(2, 4, 6, 3))), torch.from_numpy(rng.normal(size=(2, 4, 6, 3)))
    R, t, scale = fit_rigid(source, target, with_scale=True)
    assert R.shape == (2, 4, 3, 3) and t.shape == (2, 4, 3) and scale.shape == (2, 4)
    for i in np.ndindex(2, 4):
        for batch, single in zip((R[i], t[i], scale[i]), fit_rigid(source[i], target[i], with_scale=True), strict=True):
            torch.testing.assert_close(batch, single)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(2, 4, dtype=R.dtype))


def test_convention_result_maps_em_to_kidney() -> None:
    em, _, R, t = problem(np.random.default_rng(2))
    found = register_landmarks(em, 1.8 * em @ R.T + t, with_scale=True)
    assert found.scale == pytest.approx(1.8)
    np.testing.assert_allclose(found.apply(em), 1.8 * em @ R.T + t, atol=1e-9)
    np.testing.assert_allclose(found.T_kidney_em, transform_from(1.8 * R, t), atol=1e-9)
    np.testing.assert_allclose(angle_between(found.apply_direction(em), em @ R.T), 0, atol=1e-9)


def test_weights_of_zero_leave_pairs_out() -> None:
    em, kidney, R, _ = problem(np.random.default_rng(3))
    kidney[2] += 40
    found = register_landmarks(em, kidney, weights=[1, 1, 0, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(found.R, R, atol=1e-9)
    assert found.n == 7 and not found.used[2] and found.fre_mm[2] == pytest.approx(40 * 3**0.5)


@pytest.mark.parametrize("n", [8, 40])
def test_ransac_leaves_wrong_pairs_out(n: int) -> None:
    em, kidney, R, _ = problem(np.random.default_rng(4), n=n, noise_mm=0.3)
    kidney[:3] += [[30, 0, 0], [0, -25, 10], [0, 0, 60]]
    found = register_landmarks(em, kidney, ransac=3.0)
    assert found.used.tolist() == [False] * 3 + [True] * (n - 3)
    assert np.degrees(Rotation.from_matrix(found.R.T @ R).magnitude()) < 1.5


def test_ransac_without_agreement_is_refused() -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(RegistrationError, match=r"of 8 landmark pairs agree to 0\.5 mm"):
        register_landmarks(rng.normal(0, 30, (8, 3)), rng.normal(0, 30, (8, 3)), ransac=0.5)


def test_leave_one_out_is_the_error_at_the_pair_left_out() -> None:
    em, kidney, *_ = problem(np.random.default_rng(6), noise_mm=2.0)
    found = register_landmarks(em, kidney)
    for i in range(len(em)):
        without = register_landmarks(np.delete(em, i, 0), np.delete(kidney, i, 0))
        assert found.tre_loo_mm[i] == pytest.approx(np.linalg.norm(without.apply(em[i]) - kidney[i]))


def test_three_pairs_have_no_leave_one_out() -> None:
    em, kidney, R, _ = problem(np.random.default_rng(7), n=3)
    found = register_landmarks(em, kidney)
    np.testing.assert_allclose(found.R, R, atol=1e-9)
    assert found.tre_loo_rmse_mm is None and np.isnan(found.tre_loo_mm).all()


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        (lambda a, b: (a[:2], b[:2]), RegistrationError, "2 landmark pairs do not fix a rotation"),
        (lambda a, b: (a[:0], b[:0]), RegistrationError, "0 landmark pairs"),
        (lambda a, b: (a * 0 + 5, b), RegistrationError, "EM landmarks coincide"),
        (lambda a, b: (a, b * 0), RegistrationError, "kidney landmarks coincide"),
        (lambda a, b: (a[:, :1] * [1, 2, 3], b), RegistrationError, "EM landmarks are collinear"),
        (lambda a, b: (a, b[:, :1] * [1, 2, 3] + 9), RegistrationError, "kidney landmarks are collinear"),
        (lambda a, b: (np.where(a == a[3], np.nan, a), b), InputError, "Landmark 4 is not finite"),
        (lambda a, b: (a, b / 1000), InputError, "kidney points are in meters"),
        (lambda a, b: (a / 1000, b), InputError, "EM points are in meters"),
        (lambda a, b: (a, b * 1.8), InputError, "1.8 times larger"),
        (lambda a, b: (a, b[:-1]), ShapeError, "two sets"),
        (lambda a, b: (a[:, :2], b[:, :2]), ShapeError, "two sets"),
    ],
)
def test_refusals_name_the_suspicion(change, error: type[Exception], match: str) -> None:
    em, kidney, *_ = problem(np.random.default_rng(8))
    with pytest.raises(error, match=match):
        register_landmarks(*change(em, kidney))


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_pairs_are_named(seed: int) -> None:
    em, kidney, *_ = problem(np.random.default_rng(seed), noise_mm=0.5)
    order = np.array([0, 4, 2, 3, 1, 6, 5, 7])
    with pytest.warns(RegistrationWarning, match=r"shuffled.*EM 2 with kidney 5"):
        register_landmarks(em, kidney[order])


def test_a_wrong_pair_is_named() -> None:
    em, kidney, *_ = problem(np.random.default_rng(9), noise_mm=0.5)
    kidney[5] += [40, 20, 0]
    with pytest.warns(RegistrationWarning, match="Pair 6 looks wrong"):
        register_landmarks(em, kidney)


def test_a_landmark_entered_twice_and_a_thin_set_are_named() -> None:
    em, kidney, R, t = problem(np.random.default_rng(10))
    em[3], kidney[3] = em[2], kidney[2]
    with pytest.warns(RegistrationWarning, match=r"Landmarks 3 and 4 coincide \(EM and kidney\)"):
        register_landmarks(em, kidney)
    thin = em * [1, 0.01, 0.01]
    with pytest.warns(RegistrationWarning, match="almost on a line"):
        register_landmarks(np.delete(thin, 3, 0), np.delete(thin @ R.T + t, 3, 0))


def test_good_pairs_are_not_suspected() -> None:
    rng = np.random.default_rng(11)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(200):
            em, kidney, *_ = problem(rng, n=rng.integers(4, 12), noise_mm=1.5)
            assert register_landmarks(em, kidney).suspicions == ()
