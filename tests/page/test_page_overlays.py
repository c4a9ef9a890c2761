"""What is drawn over the scope's picture lies where it is, and the cloud is as wide as it says."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from ursnav_torch.exploration.route import Route
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import apply, inverse
from ursnav_torch.navigation import Guidance, NavigationState
from ursnav_torch.page.live import timeline
from ursnav_torch.page.overlays import body_outlines, cloud, names_in_picture, scope_overlays, way_in_picture


def test_a_stone_is_outlined_in_pixels_of_the_picture(lens):
    mask = np.zeros((48, 48), bool)
    mask[10:20, 30:36] = True
    ((kind, outline),) = body_outlines((ForegroundBody("stone", 0.9, (65.5, 29.5), 17.0, 0.02, mask),), lens)
    low, high = np.min(outline, axis=0), np.max(outline, axis=0)
    assert kind == "stone"
    np.testing.assert_allclose([*low, *high], [60.5, 20.5, 70.5, 38.5], atol=1.01)  # the mask is half as fine


def test_names_lie_at_the_tips_that_are_near_and_in_the_picture(vid):
    view = int(np.flatnonzero(vid.calyx == 2)[3])
    T = vid.T_kidney_camera[view]
    found = {name: (x, y) for name, x, y in names_in_picture(T, vid)}
    tip, inside = vid.camera.project(apply(inverse(T), vid.kidney.tips_mm[2]))
    assert inside and "C" in found
    np.testing.assert_allclose(found["C"], tip, atol=0.06)
    far = vid.lumen.to_calyces(T[None, :3, 3])[0] > 14.0 * vid.kidney.scale
    assert far.any() and not {c.name for c, away in zip(vid.kidney.calyces, far, strict=True) if away} & found.keys()


@pytest.mark.parametrize(
    ("ahead", "expected"),
    [([0, 0, 9], (0, 0)), ([-9, 0, 0], (-1, 0)), ([0, 9, -9], (0, 1)), ([6, 0, 6], (0.5, 0))],
    ids=["straight on", "left", "behind, below", "half right"],
)
def test_convention_the_way_points_where_the_picture_shows_it(vid, ahead, expected):
    """x to the right and y down, the angle from the axis as the length, a right angle and more at length 1."""
    T = vid.T_kidney_camera[5]
    points = np.array([T[:3, 3], apply(T, np.array(ahead, float))])
    state = NavigationState(T_kidney_camera=T, guidance=Guidance(route=route(points)))
    np.testing.assert_allclose(way_in_picture(T, state, vid), expected, atol=2e-3)
    assert msgspec.json.decode(msgspec.json.encode(scope_overlays(state, vid))).keys() == {"bodies", "names", "way"}
    assert way_in_picture(T, NavigationState(), vid) is None


def route(points):
    return Route("A", ("calyx A",), points, 9.0, 0.0, 10.0, 2.0, True)


def test_two_thirds_of_the_cloud_lie_within_the_standard_deviation_told():
    T = np.eye(4)
    T[:3, 3] = [10, 20, 30]
    points = np.array(cloud(NavigationState(T_kidney_camera=T, position_sd_mm=2.0)))
    assert np.mean(np.linalg.norm(points - T[:3, 3], axis=1) <= 2.0) == pytest.approx(2 / 3, abs=0.06)
    places = np.array([[40.0, 0, 0, 0.75], [80.0, 0, 0, 0.25]])
    searching = np.array(cloud(NavigationState(places=places)))
    assert np.mean(np.abs(searching[:, 0] - 40) < 5) == pytest.approx(0.75, abs=0.02)
    both = np.array(cloud(NavigationState(T_kidney_camera=T, position_sd_mm=2.0, places=places)))
    assert np.mean(both[:, 0] < 25) == pytest.approx(0.5, abs=0.02) and len(both) == len(points) == len(searching)
    assert cloud(NavigationState()) == []


def test_nothing_is_drawn_where_nothing_is_known(vid):
    assert scope_overlays(NavigationState(), vid) == {"bodies": [], "names": [], "way": None}


def test_a_record_without_results_has_no_time_line():
    replay = SimpleNamespace(events=lambda: iter(()), results=lambda: iter(()))
    assert timeline(SimpleNamespace(replay=replay, duration_s=3.0)) == {"moments": [], "duration_s": 3.0}
