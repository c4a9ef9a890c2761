"""PnP on rays: exact on exact pairs, unmoved by wrong ones, for any lens; and with a VID's own edges."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import EdgePnp, solve_pnp
from ursnav_torch.alignment.pnp import PnpSettings
from ursnav_torch.errors import ShapeError
from ursnav_torch.geometry import apply, inverse, look_along, rotation_angle
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

TRUE = look_along(np.array([3.0, -40.0, 12.0]), np.array([0.3, 1.0, -0.2]), 0.7)


def pairs(rng: np.random.Generator, count: int = 60, half_angle_deg: float = 80.0) -> tuple[np.ndarray, np.ndarray]:
    """Wall points and the rays along which a fisheye at `TRUE` sees them."""
    theta = np.radians(half_angle_deg) * np.sqrt(rng.random(count))
    phi = rng.uniform(0, 2 * np.pi, count)
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
    return apply(TRUE, rays * rng.uniform(2, 15, (count, 1))), rays


@pytest.mark.parametrize("half_angle_deg", [30.0, 80.0, 110.0])
def test_exact_pairs_give_the_exact_pose(half_angle_deg: float) -> None:
    points, rays = pairs(np.random.default_rng(0), half_angle_deg=half_angle_deg)
    found = solve_pnp(points, rays)
    assert found is not None and found.inliers.all()
    np.testing.assert_allclose(found.T_kidney_camera, TRUE, atol=1e-4)


def test_wrong_pairs_do_not_move_the_pose() -> None:
    rng = np.random.default_rng(1)
    points, rays = pairs(rng, 80)
    points[:32] = points[rng.permutation(32)]  # 40 % wrong
    points[40] = np.nan
    found = solve_pnp(points, rays)
    assert found is not None and found.inliers[41:].all() and not found.inliers[40]
    np.testing.assert_allclose(found.T_kidney_camera[:3, 3], TRUE[:3, 3], atol=0.05)
    assert found.inliers[:32].mean() < 0.3


def test_noise_moves_the_pose_by_little() -> None:
    rng = np.random.default_rng(2)
    points, rays = pairs(rng)
    noisy = rays + 0.01 * rng.standard_normal(rays.shape)
    found = solve_pnp(points, noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    assert found is not None
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - TRUE[:3, 3]) < 0.1
    assert rotation_angle(found.T_kidney_camera, TRUE) < 0.02


def test_the_pose_moves_with_the_kidney() -> None:
    points, rays = pairs(np.random.default_rng(3))
    T = look_along(np.array([100.0, 20.0, 5.0]), np.array([0.0, 0.0, 1.0]), -2.0)
    here, there = solve_pnp(points, rays), solve_pnp(apply(T, points), rays)
    assert here is not None and there is not None
    np.testing.assert_allclose(inverse(T) @ there.T_kidney_camera, here.T_kidney_camera, atol=1e-3)


def test_a_guess_serves_where_no_try_is_made() -> None:
    points, rays = pairs(np.random.default_rng(4))
    guess = TRUE.copy()
    guess[:3, :3] = TRUE[:3, :3] @ Rotation.from_rotvec([0.0, 0.05, 0.0]).as_matrix()
    found = solve_pnp(points, rays, PnpSettings(tries=0), guess)
    assert found is not None
    np.testing.assert_allclose(found.T_kidney_camera, TRUE, atol=1e-4)


def test_too_few_pairs_or_disagreement_give_no_pose() -> None:
    rng = np.random.default_rng(5)
    points, rays = pairs(rng)
    assert solve_pnp(points[:5], rays[:5]) is None
    assert solve_pnp(np.full((30, 3), np.nan), rays[:30]) is None
    other = pairs(rng, 7)[1]
    assert solve_pnp(50 * rng.standard_normal((7, 3)), other, PnpSettings(inlier=0.005)) is None
    with pytest.raises(ShapeError, match="rays"):
        solve_pnp(points[:4], rays)


def test_a_views_own_edges_give_its_pose(vid: Vid) -> None:
    solver = EdgePnp(vid)
    for view in (3, 20):
        picture = RaycastRenderer(vid.kidney.mesh, vid.camera).render(vid.T_kidney_camera[view]).image
        found = solver.pose(vid.extractor().extract(picture, virtual=True).edges, view, vid.T_kidney_camera[view])
        assert found is not None and found.inliers.mean() > 0.9
        assert np.linalg.norm(found.T_kidney_camera[:3, 3] - vid.T_kidney_camera[view, :3, 3]) < 0.2
