import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ursnav_torch import geometry as g
from ursnav_torch.errors import InputError, ShapeError

HALF = np.sqrt(0.5)


def random_transforms(seed: int, n: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return g.transform_from(Rotation.random(n, rng=rng).as_matrix(), rng.normal(0, 50, (n, 3)))


def test_convention_quaternions_are_x_y_z_w() -> None:
    """A quarter turn about z takes x to y; its quaternion is (0, 0, sin 45, cos 45)."""
    T = g.transform_from_quaternion([1, 2, 3], [0, 0, HALF, HALF])
    np.testing.assert_allclose(g.apply(T, [1, 0, 0]), [1, 3, 3], atol=1e-12)
    np.testing.assert_allclose(g.quaternion_from_transform(T), [0, 0, HALF, HALF], atol=1e-12)


def test_convention_transforms_chain_by_adjoining_frames() -> None:
    T_a_b, T_b_c = random_transforms(0, 2)
    p_c = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(g.apply(T_a_b @ T_b_c, p_c), g.apply(T_a_b, g.apply(T_b_c, p_c)))


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_quaternions_and_inverses_round_trip(seed: int) -> None:
    T = random_transforms(seed).reshape(5, 1, 4, 4)
    q = g.quaternion_from_transform(T)
    assert q.shape == (5, 1, 4) and (q[..., 3] >= 0).all()
    for same in (q, -q, 3 * q):
        np.testing.assert_allclose(g.transform_from_quaternion(T[..., :3, 3], same), T, atol=1e-9)
    np.testing.assert_allclose(g.inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-9)


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [np.nan, 0, 0, 1]])
def test_refuses_quaternions_that_are_no_rotation(quaternion: list[float]) -> None:
    with pytest.raises(InputError, match="x, y, z, w"):
        g.transform_from_quaternion([0, 0, 0], quaternion)


def test_apply_takes_one_transform_or_one_a_point() -> None:
    T, p = random_transforms(1), np.random.default_rng(2).normal(size=(5, 3))
    np.testing.assert_allclose(g.apply(T, p), [g.apply(a, b) for a, b in zip(T, p, strict=True)])
    with pytest.raises(ShapeError, match="points"):
        g.apply(T, p[:, :2])


def test_check_rigid_names_what_is_wrong() -> None:
    T = random_transforms(3)
    np.testing.assert_array_equal(g.check_rigid(T.tolist(), "T"), T)
    with pytest.raises(ShapeError, match=r"T_kidney_em must have shape"):
        g.check_rigid(np.eye(3), "T_kidney_em")
    with pytest.raises(InputError, match="not orthonormal"):
        g.check_rigid(np.diag([1.8, 1.8, 1.8, 1.0]), "T")
    with pytest.raises(InputError, match="mirrors"):
        g.check_rigid(np.diag([1.0, 1.0, -1.0, 1.0]), "T")
    with pytest.raises(InputError, match="T is not"):
        g.check_rigid(np.full((4, 4), np.nan), "T")


def test_convention_camera_looks_along_z_with_the_kidneys_z_up() -> None:
    T = g.look_along([1, 2, 3], [2, 0, 0])
    x, y, z, at = T[:3, :4].T
    np.testing.assert_allclose(z, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(y, [0, 0, -1], atol=1e-12)  # y is down in the picture
    np.testing.assert_allclose(x, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(at, [1, 2, 3])


def test_convention_roll_turns_x_towards_y() -> None:
    level, rolled = g.look_along([0, 0, 0], [1, 2, 0.5]), g.look_along([0, 0, 0], [1, 2, 0.5], np.radians(90))
    np.testing.assert_allclose(rolled[:3, 0], level[:3, 1], atol=1e-12)
    np.testing.assert_allclose(rolled[:3, 1], -level[:3, 0], atol=1e-12)


@pytest.mark.parametrize("direction", [[0, 0, 1], [0, 0, -1], [0.01, 0, 1], [1e-9, 1e-9, 1]])
def test_looking_up_or_down_still_gives_a_rotation(direction: list[float]) -> None:
    T = g.check_rigid(g.look_along(np.zeros((2, 3)), [direction, [1, 0, 0]], [0.2, 0.3]), "T")
    assert T[0, :3, 2] @ direction > 0.99


def test_angles() -> None:
    T = g.look_along(np.zeros((2, 3)), [1, 0, 0], [0.0, 0.3])
    np.testing.assert_allclose(g.rotation_angle(T[0], T[1]), 0.3)
    np.testing.assert_allclose(
        g.angle_between([[1, 0, 0], [1, 0, 0], [1e-8, 1, 0]], [[0, 2, 0], [-3, 0, 0], [0, 1, 0]]),
        [np.pi / 2, np.pi, 1e-8],
    )


def test_unity_by_hand() -> None:
    """Unity is left-handed, y up; Euler (0, 90, 0) turns forward (+z) to right (+x), and right to back (-z).

    With z mirrored the camera at (1, 2, 3) stands at (1, 2, -3) and looks along +x, its right is +z, its down is -y.
    """
    T = g.transform_from_unity([1, 2, 3], [0, HALF, 0, HALF], 1000 / 10.8)
    np.testing.assert_allclose(T[:3, 3], np.array([1, 2, -3]) * 92.5925926)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(T[:3, 1], [0, -1, 0], atol=1e-12)


def test_unity_against_its_own_matrices() -> None:
    """What Unity puts at M p, seen in Unity's camera axes (x right, y up, z forward), we see at the same place."""
    rng = np.random.default_rng(5)
    q, position = Rotation.random(rng=rng), rng.normal(size=3)
    p_unity = rng.normal(size=(20, 3))
    seen = (p_unity - position) @ q.as_matrix()  # R^T (p - t); the formula of R(q) is the same in either handedness
    M = np.diag([1.0, 1.0, -1.0])
    ours = g.apply(g.inverse(g.transform_from_unity(position, q.as_quat(), 10.0)), 10.0 * p_unity @ M)
    np.testing.assert_allclose(ours, 10.0 * seen * [1, -1, 1], atol=1e-9)


def test_unity_round_trips() -> None:
    T = random_transforms(4)
    position, q = g.transform_to_unity(T, 1000 / 10.8)
    np.testing.assert_allclose(g.transform_from_unity(position, q, 1000 / 10.8), T, atol=1e-9)


def test_axis_conventions_are_their_own_inverses() -> None:
    for T in (g.T_OPENGL_OPENCV, g.T_RAS_LPS):
        np.testing.assert_array_equal(T @ T, np.eye(4))
        g.check_rigid(T, "T")
    np.testing.assert_array_equal(g.apply(g.T_OPENGL_OPENCV, [1, 2, 3]), [1, -2, -3])
    np.testing.assert_array_equal(g.apply(g.T_RAS_LPS, [1, 2, 3]), [-1, -2, 3])


def test_rotation_vectors_turn_as_scipys_do() -> None:
    rotvecs = np.random.default_rng(4).normal(size=(20, 3)) * np.array([[0.0], [1e-9], [1e-4], [1.0], [3.0]]).repeat(
        4, 0
    )
    np.testing.assert_allclose(g.turned_by(rotvecs), Rotation.from_rotvec(rotvecs).as_matrix(), atol=1e-12)
    assert g.turned_by(np.zeros((0, 3))).shape == (0, 3, 3)
