"""Coverage: what a pose sees, what that makes of a calyx, and that two ways of asking agree."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.camera import Camera, mask_text
from ursnav_torch.errors import InputError
from ursnav_torch.exploration.coverage import Coverage, CoverageSettings
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RaycastRenderer, RayScene
from ursnav_torch.vid import Vid


@pytest.fixture(scope="module")
def reach(vid: Vid, phantom_lumen: LumenDistance) -> Coverage:
    return Coverage(vid.kidney, vid.camera, phantom_lumen, vid.T_kidney_camera)


@pytest.fixture
def coverage(reach: Coverage) -> Coverage:
    reach.seen_s[:] = 0
    return reach


def test_patches_hold_the_whole_wall_once(coverage: Coverage, phantom: Kidney) -> None:
    patches = coverage.patches
    assert patches.area_mm2.sum() == pytest.approx(phantom.mesh.area, rel=1e-6)
    assert set(patches.of_face) == set(range(len(patches.area_mm2)))
    assert (patches.area_mm2 > 0).all()


def test_every_calyx_has_wall_around_its_tip(coverage: Coverage, phantom: Kidney) -> None:
    for index, calyx in enumerate(phantom.calyces):
        own = coverage.patches.center_mm[coverage.patches.calyx == index]
        assert np.linalg.norm(own - calyx.tip_mm, axis=1).min() < 2.0


def test_what_is_in_view_shows_in_a_drawing_from_there(
    coverage: Coverage, phantom: Kidney, vid: Vid, renderer: RaycastRenderer
) -> None:
    T = vid.T_kidney_camera[5]
    seen = coverage.in_view(T)
    pixels, inside = vid.camera.project((coverage.patches.center_mm[seen] - T[:3, 3]) @ T[:3, :3])
    drawn = renderer.render(T).depth_mm
    depth = drawn[tuple(np.rint(pixels[:, ::-1]).astype(int).T)]
    far = np.linalg.norm(coverage.patches.center_mm[seen] - T[:3, 3], axis=1)
    assert len(seen) > 20 and inside.all()
    assert np.median(np.abs(depth - far)) < 0.5
    assert far.max() <= coverage.settings.farthest_mm


def test_what_lies_behind_the_camera_or_a_wall_is_not_in_view(coverage: Coverage, phantom: Kidney, vid: Vid) -> None:
    T = vid.T_kidney_camera[5]
    seen = coverage.in_view(T)
    way = coverage.patches.center_mm[seen] - T[:3, 3]
    ray = way / np.linalg.norm(way, axis=1, keepdims=True)
    assert (ray @ T[:3, 2]).min() > 0
    depth, _ = RayScene(phantom.mesh).cast(T[:3, 3], ray)
    assert (depth > np.linalg.norm(way, axis=1) - 1.1).all()


def test_distances_alone_are_those_of_a_cast(phantom: Kidney, vid: Vid) -> None:
    scene, T = RayScene(phantom.mesh), vid.T_kidney_camera[5]
    rays = np.array([T[:3, 2], T[:3, 0], -T[:3, 1]])
    far = T[:3, 3] + 1e3 * np.array([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(scene.depth_mm(T[:3, 3], rays), scene.cast(T[:3, 3], rays)[0])
    assert scene.depth_mm(far, [[1.0, 0.0, 0.0]])[0] > 1e6, "no wall there"


def test_nothing_is_unseen_of_all_that_the_views_see(coverage: Coverage, vid: Vid) -> None:
    for T in vid.T_kidney_camera:
        coverage.add(T, 0.25)
        coverage.add(T, 0.25)
    assert coverage.seen()[coverage.in_reach].all()
    assert {c.verdict for c in coverage.calyces()} == {"inspected"}


def test_only_the_calyx_visited_is_inspected(coverage: Coverage, vid: Vid) -> None:
    for T in vid.T_kidney_camera[vid.calyx == 0]:
        coverage.add(T, 0.25)
        coverage.add(T, 0.25)
    verdicts = [c.verdict for c in coverage.calyces()]
    assert verdicts[0] == "inspected"
    assert "inspected" not in verdicts[1:]


def test_a_glance_is_not_enough(coverage: Coverage, vid: Vid) -> None:
    coverage.add(vid.T_kidney_camera[0], 0.1)
    assert not coverage.seen().any()
    coverage.add(vid.T_kidney_camera[0], 100.0)  # a gap in the video counts no longer than a picture may
    assert coverage.seen_s.max() == pytest.approx(0.1 + coverage.settings.longest_gap_s)
    assert coverage.seen().any()


def test_wall_behind_a_stone_is_not_seen(coverage: Coverage, vid: Vid) -> None:
    """A stone over the picture's left half, at half the picture's size: the wall to its right alone counts."""
    T, (height, width) = vid.T_kidney_camera[5], (vid.camera.height // 2, vid.camera.width // 2)
    left = np.zeros((height, width), bool)
    left[:, : width // 2] = True
    coverage.add(T, 0.25, [ForegroundBody("stone", 0.99, (0.0, 0.0), 1.0, 0.5, left)])
    counted, in_view = np.flatnonzero(coverage.seen_s), coverage.in_view(T)
    x = ((coverage.patches.center_mm[in_view] - T[:3, 3]) @ T[:3, :3])[:, 0]
    assert set(in_view[x > 0.1]) <= set(counted) <= set(in_view[x > -0.1]) and (x < -0.1).sum() > 5


def test_wall_behind_nothing_counts_as_before(coverage: Coverage, vid: Vid) -> None:
    T = vid.T_kidney_camera[5]
    empty = np.zeros((40, 40), bool)
    coverage.add(T, 0.25, [ForegroundBody("instrument", 0.99, (0.0, 0.0), 1.0, 0.0, empty)])
    assert set(np.flatnonzero(coverage.seen_s)) == set(coverage.in_view(T))


def test_a_larger_phantom_is_covered_alike(phantom: Kidney, lens: Camera, vid: Vid) -> None:
    twice = phantom.scaled(2.0)
    coverage = Coverage(twice, lens, LumenDistance.from_kidney(twice))
    T = vid.T_kidney_camera[3].copy()
    once = Coverage(phantom, lens, LumenDistance.from_kidney(phantom))
    share = once.patches.area_mm2[once.in_view(T)].sum() / phantom.mesh.area
    T[:3, 3] *= 2
    assert coverage.patches.area_mm2[coverage.in_view(T)].sum() / twice.mesh.area == pytest.approx(share, rel=0.1)


def test_the_report_is_plain_and_its_shares_are_shares(coverage: Coverage, phantom: Kidney) -> None:
    report = json.loads(json.dumps(coverage.to_dict()))
    assert set(report["calyces"]) == {c.name for c in phantom.calyces}
    assert all(c["verdict"] == "unseen" and c["share"] == 0 for c in report["calyces"].values())
    assert 0.3 < report["reachable"] <= 1.0 and report["share"] == 0


def test_what_no_pose_can_see_is_out_of_reach(phantom: Kidney, lens: Camera, phantom_lumen: LumenDistance) -> None:
    outside = look_along(np.array([[500.0, 0, 0]]), np.array([[1.0, 0, 0]]))
    coverage = Coverage(phantom, lens, phantom_lumen, outside)
    assert {c.verdict for c in coverage.calyces()} == {"out of reach"}


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(InputError, match="nearest_mm < farthest_mm"):
        CoverageSettings(nearest_mm=20.0)
    with pytest.raises(InputError, match="glimpsed <= inspected"):
        CoverageSettings(glimpsed=0.9)
    with pytest.raises(InputError, match="largest_sd_mm > 0, got 0"):
        CoverageSettings(largest_sd_mm=0.0)


@pytest.mark.parametrize(("sd_mm", "counts"), [(None, True), (0.85, True), (0.95, False), (np.nan, False)])
def test_a_picture_counts_only_where_its_place_is_sure(
    coverage: Coverage, vid: Vid, sd_mm: float | None, counts: bool
) -> None:
    coverage.add(vid.T_kidney_camera[5], 0.1, position_sd_mm=sd_mm)
    assert (coverage.seen_s > 0).any() == counts


def test_a_larger_kidney_allows_a_larger_deviation(phantom: Kidney, lens: Camera, vid: Vid) -> None:
    larger = replace(phantom, scale=2.0 * phantom.scale)
    coverage = Coverage(larger, lens, LumenDistance.from_kidney(larger))
    coverage.add(vid.T_kidney_camera[5], 0.1, position_sd_mm=1.2)
    assert (coverage.seen_s > 0).any()


def test_of_a_place_that_may_be_off_only_wall_counts_that_shows_all_the_same(coverage: Coverage, vid: Vid) -> None:
    """From a place off to the side, next to nothing is counted that the true place does not show."""
    T, rng = vid.T_kidney_camera[5], np.random.default_rng(3)
    truth, wrong, wrong_sure, counted = set(coverage.in_view(T)), 0, 0, 0
    for _ in range(12):
        off = T.copy()
        off[:3, 3] += rng.normal(0, 0.3, 3)
        plain, sure = set(coverage.in_view(off)), set(coverage.surely_in_view(off, 3**0.5 * 0.5))
        assert sure <= plain
        wrong, wrong_sure, counted = wrong + len(plain - truth), wrong_sure + len(sure - truth), counted + len(sure)
    assert wrong_sure < 0.6 * wrong and counted > 4 * len(truth)
    assert set(coverage.surely_in_view(T, 0.0)) == truth


def test_wall_that_the_picture_does_not_show_is_not_in_view(phantom: Kidney, lens: Camera, vid: Vid) -> None:
    """The lens's own mask, and a scene that is found, or said, to be narrower still."""
    upper, lumen = np.zeros((lens.height, lens.width), bool), LumenDistance.from_kidney(phantom)
    T = vid.T_kidney_camera[5]
    upper[: lens.height // 2] = True
    whole, masked = (Coverage(phantom, one, lumen) for one in (lens, replace(lens, mask=mask_text(upper))))
    y = ((whole.patches.center_mm - T[:3, 3]) @ T[:3, :3])[:, 1]
    shown, half = whole.in_view(T), masked.in_view(T)
    assert set(shown[y[shown] < -0.1]) <= set(half) <= set(shown[y[shown] < 0.1]) and len(half) < 0.8 * len(shown)
    whole.look_through(upper)
    np.testing.assert_array_equal(whole.in_view(T), half)
    masked.look_through(None)
    np.testing.assert_array_equal(masked.in_view(T), half)
    whole.look_through(None)
    np.testing.assert_array_equal(whole.in_view(T), shown)
