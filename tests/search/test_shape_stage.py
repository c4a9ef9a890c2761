"""Shapes of a turned picture compared with views: where points go, and what the distances are."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ursnav_torch.camera import Camera
from ursnav_torch.features import EdgePoints, Features
from ursnav_torch.geometry import transform_from
from ursnav_torch.matching import Hungarian, Matching, Nearest, PairCost, ShapeContext, Sinkhorn
from ursnav_torch.matching.methods.base import Method
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search.settings import default_matching
from ursnav_torch.search.shape import ShapeStage, turn_edges
from ursnav_torch.vid import Vid


def edges(lens: Camera, count: int = 30) -> EdgePoints:
    rng = np.random.default_rng(0)
    points = torch.from_numpy(np.array([lens.cx, lens.cy]) + rng.uniform(-25, 25, (count, 2))).float()
    return EdgePoints(points, torch.from_numpy(rng.uniform(0, np.pi, count)).float(), torch.ones(count))


def test_convention_the_ray_there_is_the_rotation_times_the_ray_here(lens: Camera) -> None:
    seen, R = edges(lens), Rotation.from_rotvec([[0.1, -0.05, 0.4], [0.0, 0.2, -1.0]]).as_matrix()
    points, direction = turn_edges(seen, lens, R)
    assert points.shape == (2, 30, 2) and direction.shape == (2, 30)
    for turn, there in zip(R, points.numpy().astype(float), strict=True):
        rays, _ = lens.rays(seen.points.numpy().astype(float))
        np.testing.assert_allclose(lens.rays(there)[0], rays @ turn.T, atol=1e-5)


@pytest.mark.parametrize("degrees", [30.0, -110.0])
def test_a_roll_turns_points_about_the_middle_and_edges_with_them(lens: Camera, degrees: float) -> None:
    seen, angle = edges(lens), np.radians(degrees)
    points, direction = turn_edges(seen, lens, Rotation.from_rotvec([[0.0, 0.0, angle]]).as_matrix())
    c, s = np.cos(angle), np.sin(angle)
    middle = np.array([lens.cx, lens.cy])
    there = (seen.points.numpy() - middle) @ np.array([[c, s], [-s, c]]) + middle
    np.testing.assert_allclose(points[0], there, atol=1e-3)
    turned = 2 * (direction[0].numpy() - seen.direction.numpy() - angle)  # an edge has no head and no tail
    np.testing.assert_allclose(np.cos(turned), 1.0, atol=2e-3)
    assert (direction >= 0).all() and (direction <= np.pi).all()


@pytest.fixture(scope="module")
def picture_features(vid: Vid, picture: np.ndarray) -> Features:
    return vid.extractor().extract(picture)


@pytest.mark.parametrize(
    "method",
    [Nearest(), Nearest(keep=0.7), Nearest(sides="sum"), Nearest(sides="view_to_query"),
     Sinkhorn(tolerance=float("inf")), Hungarian(exact=None)],
    ids=["nearest", "trimmed", "both sides", "view to query", "sinkhorn", "hungarian"],
)  # fmt: skip
def test_unturned_the_distances_are_those_to_every_view(vid: Vid, picture_features: Features, method: Method) -> None:
    matching = Matching(ShapeContext(scale=1.0, r_inner=5.0, r_outer=40.0), PairCost(position_weight=1.0), method)
    stage, views = ShapeStage(vid.features, vid.camera, matching), torch.tensor([3, 0, 40])
    every, roll = stage.everywhere(picture_features.edges)
    some = stage.finalists(picture_features.edges, views, np.tile(np.eye(3), (3, 1, 1))).distance
    assert (roll == 0).all()
    torch.testing.assert_close(some, every[views], atol=2e-3, rtol=0)
    assert some[0] == some.min() and (every >= 0).all() and every.max() < 1.0


def test_a_rolled_picture_turned_back_is_near_its_view_and_turned_the_wrong_way_is_far(
    vid: Vid, renderer: RaycastRenderer
) -> None:
    T = vid.T_kidney_camera[3] @ transform_from(Rotation.from_rotvec([0, 0, 0.7]).as_matrix(), np.zeros(3))
    seen = vid.extractor().extract(renderer.render(T).image).edges
    stage = ShapeStage(vid.features, vid.camera, default_matching())
    R = Rotation.from_rotvec([[0, 0, 0.7], [0, 0, 0], [0, 0, -0.7]]).as_matrix()
    right, none, wrong = stage.finalists(seen, torch.tensor([3, 3, 3]), R).distance.tolist()
    assert right < 0.5 * none and right < 0.5 * wrong


def test_no_points_are_infinitely_far(vid: Vid) -> None:
    stage = ShapeStage(vid.features, vid.camera, default_matching())
    nothing = EdgePoints(torch.zeros(0, 2), torch.zeros(0), torch.zeros(0))
    assert stage.finalists(nothing, torch.tensor([3]), np.eye(3)[None]).distance.isinf().all()
    assert stage.everywhere(nothing)[0].isinf().all()
