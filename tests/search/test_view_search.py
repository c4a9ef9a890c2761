"""One search for stills and videos: what it finds, how it is turned, and that finalists are solved as asked."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.features import NO_EDGES, Features, polar_grid, polar_maps
from ursnav_torch.geometry import rotation_angle, transform_from
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.matching import Hungarian, Matching, Nearest, PairCost, Sinkhorn
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import VIDEO_SEARCH, SearchSettings, ViewSearch, default_matching
from ursnav_torch.search.ranking import view_from_query
from ursnav_torch.search.shape import turn_edges
from ursnav_torch.vid import Vid


@pytest.fixture(scope="module")
def search(vid: Vid) -> ViewSearch:
    return ViewSearch(vid)


def seen(vid: Vid, renderer: RaycastRenderer, T_kidney_camera: np.ndarray) -> Features:
    return vid.extractor().extract(renderer.render(T_kidney_camera).image, virtual=True)


def turned(vid: Vid, view: int, *, roll_deg: float = 0.0, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A view's camera rolled and then tilted about its own x and y axes."""
    R = Rotation.from_euler("z", roll_deg, degrees=True) * Rotation.from_rotvec(np.radians([*tilt_deg, 0.0]))
    return vid.T_kidney_camera[view] @ transform_from(R.as_matrix(), np.zeros(3))


@pytest.mark.parametrize("roll_deg", [0.0, 35.0, -120.0])
@pytest.mark.parametrize("tilt_deg", [(8.0, 0.0), (0.0, -8.0), (-6.0, 6.0)])
def test_convention_a_hypothesis_is_turned_as_the_picture_was(
    search: ViewSearch, vid: Vid, renderer: RaycastRenderer, roll_deg: float, tilt_deg: tuple[float, float]
) -> None:
    """Sign of roll and tilt without any refinement: a wrong sign is off by 16 degrees at least."""
    truth = turned(vid, 3, roll_deg=roll_deg, tilt_deg=tilt_deg)
    found = search.rank(seen(vid, renderer, truth))
    row = int(np.flatnonzero(found.views == 3)[0])
    assert row < 3
    assert np.degrees(rotation_angle(found.T_kidney_camera[row], truth)) < 9
    np.testing.assert_allclose(found.T_kidney_camera[row, :3, 3], vid.T_kidney_camera[3, :3, 3], atol=1e-9)
    np.testing.assert_allclose(
        found.T_kidney_camera[row, :3, :3], vid.T_kidney_camera[3, :3, :3] @ found.R_view_query[row], atol=1e-9
    )


def test_convention_roll_first_then_the_tilt_undone() -> None:
    tilt = Rotation.from_rotvec([0.1, 0.2, 0.0]).as_matrix()
    R = view_from_query(np.array([0.3]), tilt)[0]
    np.testing.assert_allclose(R @ tilt, Rotation.from_rotvec([0, 0, 0.3]).as_matrix(), atol=1e-12)


def test_distances_ascend_and_a_view_is_its_own_nearest(
    search: ViewSearch, vid: Vid, renderer: RaycastRenderer
) -> None:
    found = search.rank(seen(vid, renderer, vid.T_kidney_camera[27]))
    assert found.views[0] == 27 and len(found) == 32 == len(set(found.views.tolist()))
    assert np.all(np.diff(found.distance) >= 0) and 0 <= found.distance[0] < 0.02
    assert found.assignment is not None and torch.equal(
        found.assignment.distance.argsort()[:1], torch.tensor([0])
    )  # correspondences follow the order of the ranking


def test_a_videos_search_is_the_same_scan_with_fewer_tilts(vid: Vid, renderer: RaycastRenderer) -> None:
    features = seen(vid, renderer, turned(vid, 3, roll_deg=50.0))
    search = ViewSearch(vid, VIDEO_SEARCH)
    everywhere = search.everywhere(features)
    assert everywhere.views[everywhere.score.argmax()] == 3
    assert np.degrees(rotation_angle(everywhere.T_kidney_camera[3], turned(vid, 3, roll_deg=50.0))) < 3
    tilted = search.at_tilts(features, np.array([5, 3]))
    assert tilted.views.tolist() == [5, 3] and np.all(tilted.score >= everywhere.score[[5, 3]] - 1e-5)
    assert search.with_shapes(features, tilted) is tilted and search.rank(features).assignment is None


def test_shape_alone_finds_the_roll_too(vid: Vid, renderer: RaycastRenderer) -> None:
    """The roll that the matching named was dropped: a picture rolled by 20 degrees came out 20 degrees wrong."""
    truth = turned(vid, 3, roll_deg=20.0)
    by_shape = SearchSettings(relief_weight=0.0, direction_weight=0.0)
    matching = replace(default_matching(), roll_deg=(-20.0, 0.0, 20.0))
    localizer = Localizer(vid, matching, LocalizationSettings(refine=False), by_shape)
    found = localizer.locate(renderer.render(truth).image)
    assert found.view == 3
    assert np.degrees(rotation_angle(found.candidates[0].T_kidney_camera, truth)) < 1e-3


def test_hungarian_solves_an_assignment_for_every_finalist(vid: Vid, renderer: RaycastRenderer) -> None:
    """It gave a lower bound and called no solver."""
    matching = replace(default_matching(), method=Hungarian())
    search = ViewSearch(vid, SearchSettings(finalists=6), matching)
    features = seen(vid, renderer, turned(vid, 3, roll_deg=15.0))
    found = search.rank(features)
    assert found.assignment is not None
    assert search._shape is not None
    paired = search._shape._matcher.paired
    points, direction = turn_edges(features.edges, vid.camera, found.R_view_query)
    cost = paired.costs(points, direction, torch.from_numpy(found.views))
    for k, view in enumerate(found.views):
        matrix = cost[:, k, vid.features.mask[view]].numpy()
        rows, columns = linear_sum_assignment(matrix)
        assert float(found.assignment.distance[k]) == pytest.approx(matrix[rows, columns].mean(), abs=1e-5)
        kept = vid.features.mask[view].nonzero().flatten()[columns]
        assert torch.equal(found.assignment.view_point[k, rows], kept)


@pytest.mark.parametrize("sides", ["view_to_query", "sum"])
def test_both_sides_of_nearest_are_means(vid: Vid, renderer: RaycastRenderer, sides: str) -> None:
    """The view's side was a sum over its points, so that distances of 5 came out where 1 is the largest."""
    picture = seen(vid, renderer, turned(vid, 3, roll_deg=10.0))
    distances = {}
    for side in ("query_to_view", "view_to_query", "sum"):
        matching = replace(default_matching(), method=Nearest(side, keep=1.0))  # type: ignore[arg-type]
        found = ViewSearch(vid, SearchSettings(finalists=8), matching).rank(picture)
        assert found.assignment is not None
        distances[side] = dict(zip(found.views.tolist(), found.assignment.distance.tolist(), strict=True))
    expected = distances["view_to_query"]
    if sides == "sum":
        expected = {
            v: d + distances["query_to_view"][v] for v, d in expected.items() if v in distances["query_to_view"]
        }
    for view, distance in expected.items():
        assert distances[sides].get(view, distance) == pytest.approx(distance, abs=1e-5)
        assert 0 <= distances["view_to_query"][view] < 1
    answer = Localizer(vid, replace(default_matching(), method=Nearest(sides, keep=1.0)))  # type: ignore[arg-type]
    assert answer.locate(renderer.render(vid.T_kidney_camera[3]).image).view == 3


@pytest.mark.parametrize("method", [Nearest(keep=0.7), Nearest("sum"), Sinkhorn(), Hungarian(None)])
@pytest.mark.parametrize("compare", ["hellinger", "chi2"])
def test_finalists_at_once_are_what_each_is_alone(
    vid: Vid, method: Nearest | Sinkhorn | Hungarian, compare: str
) -> None:
    from ursnav_torch.matching import Matcher

    cost = PairCost(compare, position_weight=1.0, direction_weight=1.0)  # type: ignore[arg-type]
    matching = Matching(default_matching().descriptor, cost, method)
    f = vid.features
    matcher = Matcher(f.points, f.mask, f.direction, matching)
    points = f.points[:4, :60]
    together = matcher.assign(points, f.direction[:4, :60], torch.tensor([9, 20, 20, 31]))
    for k, view in enumerate([9, 20, 20, 31]):
        alone = matcher.distances(points[k], f.direction[k, :60])[view]
        assert float(together.distance[k]) == pytest.approx(float(alone), abs=2e-5)
    assert together.view_point.shape == (4, 60) and float(together.strength.max()) <= 1 + 1e-5


def test_a_weight_a_point_counts_in_the_assignment(vid: Vid) -> None:
    """Half of a view's own points moved away: with no weight on those, it is its own nearest again."""
    from ursnav_torch.matching import Matcher

    f = vid.features
    matcher = Matcher(f.points, f.mask, f.direction, default_matching())
    points = f.points[[3]].clone()
    half = torch.arange(points.shape[1]) % 2 == 0
    points[:, half] += 37.0
    plain = matcher.assign(points, f.direction[[3]], torch.tensor([3]))
    weighed = matcher.assign(points, f.direction[[3]], torch.tensor([3]), (~half).float())
    assert float(weighed.distance) < 0.5 * float(plain.distance)


def test_turned_edges_are_where_a_turned_camera_sees_them(vid: Vid, renderer: RaycastRenderer) -> None:
    f, R = vid.features, Rotation.from_rotvec([0.1, -0.05, 0.6]).as_matrix()
    features = seen(vid, renderer, vid.T_kidney_camera[3])
    points, direction = turn_edges(features.edges, vid.camera, R[None])
    rays, _ = vid.camera.rays(features.edges.points.numpy().astype(float))
    np.testing.assert_allclose(points[0].numpy(), vid.camera.project(rays @ R.T)[0], atol=1e-3)
    assert f.points.shape[1] >= points.shape[1] == direction.shape[1]


def test_refusals() -> None:
    with pytest.raises(InputError, match="must be >= 0 and not all 0"):
        SearchSettings(0.0, 0.0, 0.0)
    with pytest.raises(InputError, match="1 <= finalists <= scan_finalists"):
        SearchSettings(finalists=300)


def test_views_are_described_when_they_are_first_finalists(vid: Vid, renderer: RaycastRenderer) -> None:
    """A search starts without describing the VID; the same views asked for again give the same costs."""
    search = ViewSearch(vid, SearchSettings(finalists=5))
    assert search._shape is not None
    paired = search._shape._matcher.paired
    assert not paired._described.any()
    features = seen(vid, renderer, vid.T_kidney_camera[3])
    first, again = search.rank(features), search.rank(features)
    assert sorted(first.views.tolist()) == paired._described.nonzero().flatten().tolist()
    np.testing.assert_array_equal(first.distance, again.distance)


def test_without_edge_points_shapes_have_no_say(vid: Vid, renderer: RaycastRenderer, search: ViewSearch) -> None:
    features = seen(vid, renderer, vid.T_kidney_camera[3])
    found = search.at_tilts(features, np.arange(8))
    assert search.reads_edges and not ViewSearch(vid, VIDEO_SEARCH).reads_edges
    assert search.with_shapes(features, found).best_score > found.best_score
    assert search.with_shapes(replace(features, edges=NO_EDGES), found) is found


def test_what_is_not_wall_does_not_count(search: ViewSearch, vid: Vid, renderer: RaycastRenderer) -> None:
    """A third of the picture spoiled: told so, the scan finds the view and scores it as if it were whole."""
    whole, rng = seen(vid, renderer, vid.T_kidney_camera[27]), np.random.default_rng(2)
    height, width = whole.fields.shape[1:]
    valid = torch.ones(height, width)
    valid[: height // 3] = 0
    noise = torch.from_numpy(rng.normal(0, 2, whole.fields.shape).astype(np.float32))
    fields = torch.where(valid > 0, whole.fields, noise)
    spoiled = replace(whole, fields=fields, maps=polar_maps(fields, polar_grid(vid.extractor().working_camera))[0])
    told, blind = replace(spoiled, valid=valid), spoiled
    everywhere = {name: search.everywhere(f) for name, f in (("whole", whole), ("told", told), ("blind", blind))}
    assert int(everywhere["told"].score.argmax()) == 27
    perfect = everywhere["whole"].score[27]
    assert everywhere["told"].score[27] > 0.93 * perfect > 1.15 * everywhere["blind"].score[27]
    few = np.array([5, 27, 40])
    at_tilts = {name: search.at_tilts(f, few) for name, f in (("told", told), ("blind", blind))}
    assert at_tilts["told"].score[1] > 0.93 * perfect > 1.1 * at_tilts["blind"].score[1]
