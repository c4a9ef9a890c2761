import numpy as np
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import inverse, rotation_angle, transform_from
from ursnav_torch.search.pose_mean import are_near, mean_pose


def poses(rng: np.random.Generator, count: int, spread_mm: float, spread_deg: float) -> np.ndarray:
    turn = Rotation.from_rotvec(np.radians(spread_deg) * rng.standard_normal((count, 3)))
    return transform_from(turn.as_matrix(), spread_mm * rng.standard_normal((count, 3)))


def test_the_mean_is_nearer_than_most_of_what_it_is_made_of() -> None:
    T = poses(np.random.default_rng(0), 40, 0.4, 4.0)
    mean, share = mean_pose(T, np.ones(40), 0, near_mm=3.0, near_deg=60.0)
    assert share == 1.0
    assert np.linalg.norm(mean[:3, 3]) < np.median(np.linalg.norm(T[:, :3, 3], axis=1)) / 2
    assert rotation_angle(mean, np.eye(4)) < np.median(rotation_angle(T, np.eye(4))) / 2


def test_another_place_has_no_say() -> None:
    T = poses(np.random.default_rng(1), 6, 0.2, 2.0)
    T[3:, 0, 3] += 20.0
    mean, share = mean_pose(T, np.array([1.0, 1, 1, 5, 5, 5]), 1, near_mm=3.0)
    assert abs(mean[0, 3]) < 1.0 and np.isclose(share, 3 / 18)


def test_it_moves_with_the_kidney() -> None:
    rng = np.random.default_rng(2)
    T, moved = poses(rng, 8, 0.5, 5.0), poses(rng, 1, 10.0, 50.0)[0]
    weight = rng.random(8) + 0.1
    here, there = (mean_pose(p, weight, 0, near_mm=5.0)[0] for p in (T, moved @ T))
    np.testing.assert_allclose(inverse(moved) @ there, here, atol=1e-9)


def test_one_pose_alone_is_its_own_mean() -> None:
    T = poses(np.random.default_rng(3), 1, 5.0, 40.0)
    np.testing.assert_allclose(mean_pose(T, np.array([0.3]), 0, near_mm=3.0)[0], T[0], atol=1e-12)


def test_one_place_is_near_in_way_and_in_turn() -> None:
    far, turned = np.eye(4), np.eye(4)
    far[0, 3] = 3.1
    turned[:3, :3] = Rotation.from_rotvec([0, 0, np.radians(26)]).as_matrix()
    assert are_near(np.stack([np.eye(4), far, turned]), np.eye(4), 3.0, 25.0).tolist() == [True, False, False]
    assert are_near(np.zeros((0, 4, 4)), np.eye(4), 3.0, 25.0).shape == (0,)


def test_rotations_have_scipys_mean_however_far_they_are_turned() -> None:
    rng = np.random.default_rng(5)
    for spread in (1.0, 20.0, 50.0):
        T, weight = poses(rng, 5, 0.1, spread), rng.random(5) + 0.1
        mean, share = mean_pose(T, weight, 0, near_mm=3.0, near_deg=180.0)
        expected = Rotation.from_matrix(T[:, :3, :3]).mean(weights=weight).as_matrix()
        assert share == 1.0
        np.testing.assert_allclose(mean[:3, :3], expected, atol=1e-9)
