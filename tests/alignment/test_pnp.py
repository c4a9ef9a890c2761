"""PnP on rays: exact on exact pairs, unmoved by wrong ones, for any lens; and with a VID's own edges."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import EdgePnp, PnpSettings, solve_pnp, starts_from
from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.geometry import apply, inverse, look_along, rotation_angle
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.matching import Sinkhorn
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import ViewSearch, default_matching
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


def test_correspondences_of_a_search_give_a_pose_nearer_than_the_view(vid: Vid) -> None:
    """A millimeter beside view 3, the search has the picture at the view's own place; PnP moves it."""
    renderer, T = RaycastRenderer(vid.kidney.mesh, vid.camera), vid.T_kidney_camera[3].copy()
    T[:3, 3] += T[:3, 0]
    features = vid.extractor().extract(renderer.render(T).image, virtual=True)
    method = Sinkhorn(0.05, iterations=20, tolerance=float("inf"), dummy_cost=0.2)
    found = ViewSearch(vid, matching=replace(default_matching(), method=method)).rank(features)
    assert found.views[0] == 3
    (start,) = starts_from(vid, features.edges, found, [0], PnpSettings())
    off = [np.linalg.norm(pose[:3, 3] - T[:3, 3]) for pose in (start, found.T_kidney_camera[0])]
    assert off[0] < 0.7 * off[1]
    nothing = replace(found.assignment, strength=torch.zeros_like(found.assignment.strength))  # type: ignore[type-var]
    assert starts_from(vid, features.edges, replace(found, assignment=nothing), [0], PnpSettings()) == []
    assert starts_from(vid, features.edges, replace(found, assignment=None), [0], PnpSettings()) == []


def test_a_localizer_refines_what_pnp_gives_where_it_is_asked_to(vid: Vid, picture: np.ndarray) -> None:
    plain, more = (Localizer(vid, settings=LocalizationSettings(pnp_starts=n)) for n in (0, 2))
    features = plain.features(picture)
    ranking = plain.search.rank(features)
    without, beside = (each.starts(ranking, 6, features) for each in (plain, more))
    np.testing.assert_array_equal(without[0], beside[0])
    wanted = starts_from(vid, features.edges, ranking, more._distinct(ranking.T_kidney_camera, 6)[:2], PnpSettings())
    assert wanted and len(beside) == 6
    np.testing.assert_allclose(beside[1 : 1 + len(wanted)], wanted)
    np.testing.assert_array_equal(beside[1 + len(wanted) :], without[1 : 6 - len(wanted)])
    with pytest.raises(InputError, match="pnp_starts"):
        LocalizationSettings(pnp_starts=-1)
