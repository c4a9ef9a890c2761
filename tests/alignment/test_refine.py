"""Refinement: its drawings agree with the package's own, it finds known poses, and stays in the lumen."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import Expectation, RefinementSettings, Refiner
from ursnav_torch.alignment.align import Aligned
from ursnav_torch.alignment.fields import AlignGrid
from ursnav_torch.alignment.light import AT_CAMERA, STEP, gray_values
from ursnav_torch.alignment.refine import _better_half
from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Features, ThesisSettings
from ursnav_torch.features.flatten import LocalPlane, flatten, masked_blur
from ursnav_torch.geometry import inverse, rotation_angle, transform_from
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.rendering.sensor import LightFaults, SensorFaults, simulate
from ursnav_torch.vid import Vid


@pytest.fixture(scope="module")
def grid(lens: Camera) -> AlignGrid:
    return AlignGrid(lens, 62, DefaultSettings())


@pytest.fixture(scope="module")
def fine(vid: Vid) -> Vid:
    """The small VID through a lens of 250 px; its views are not refined, so they may stay what they are."""
    return replace(vid, camera=equidistant_camera(160.0, 250, 250))


@pytest.fixture(scope="module")
def refiner(fine: Vid, phantom_lumen: LumenDistance) -> Refiner:
    return Refiner(fine)


def features(vid: Vid, phantom: Kidney, T: np.ndarray, light: HeadLight | None = None) -> Features:
    """What a picture from a pose looks like."""
    return vid.extractor().extract(RaycastRenderer(phantom.mesh, vid.camera, light).render(T).image)


def pushed(T: np.ndarray, rng: np.random.Generator, far_mm: float, turned_deg: float) -> np.ndarray:
    """A pose so far from another and turned so much, in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    turn = Rotation.from_rotvec(np.radians(turned_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return T @ transform_from(turn, far_mm * shift / np.linalg.norm(shift))


def test_a_drawings_relief_is_the_extractors(grid: AlignGrid, phantom: Kidney, vid: Vid) -> None:
    gray = RaycastRenderer(phantom.mesh, grid.camera).render(vid.T_kidney_camera[3]).image.astype(np.float32)
    mask, settings = torch.from_numpy(grid.mask), DefaultSettings()
    log_image = masked_blur(torch.log(torch.from_numpy(gray) + 8), mask, max(settings.relief_blur * 62, 0.5))
    expected = flatten(log_image, mask, LocalPlane(mask, settings.relief_reach * 62)).numpy()
    np.testing.assert_allclose(grid.relief(gray[None])[0], expected, atol=2e-3)


def test_a_drawings_gray_values_are_the_headlights() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 2, (500, 3)).astype(np.float32) + np.float32([0, 0, 8])
    normals = rng.normal(0, 0.4, (500, 3)) - [0, 0, 1]
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    lights = AT_CAMERA + np.array([1.0, -0.5, 0.2, 1.0, 0.1, 0.0])
    lights = lights + np.concatenate([np.zeros((1, 6)), np.diag(STEP)[:-1]])
    gray = gray_values(points.T, normals.T, lights, 10.0).T
    for column, (x, y, z, reach, ambient, _) in zip(gray.T, lights, strict=True):
        alone = 255 * HeadLight((x, y, z), reach_mm=reach, ambient=ambient).shade(points, normals)
        dark = (alone < 200) & (column < 200)  # elsewhere exposure may clip
        share = column[dark] / alone[dark]  # all lights share the first one's exposure
        np.testing.assert_allclose(share, np.median(share), rtol=2e-3)
    first = 255 * HeadLight(tuple(lights[0, :3]), reach_mm=lights[0, 3], ambient=lights[0, 4]).shade(points, normals)
    np.testing.assert_allclose(gray[:, 0], first, rtol=1e-3)


def test_water_glows_the_more_the_farther_the_wall_is() -> None:
    away = np.float32([1.0, 10.0, 60.0])
    points, normals = np.outer([0, 0, 1], away).astype(np.float32), np.float32([[0] * 3, [0] * 3, [-1] * 3])
    clear, murky = gray_values(points, normals, AT_CAMERA + np.outer([0, 1], [0, 0, 0, 0, 0, 0.2]), 10.0)
    np.testing.assert_allclose(murky - clear, 51 * (1 - np.exp(-away / 10)), rtol=1e-3)


def test_motion_says_where_a_moved_wall_point_is_seen(grid: AlignGrid) -> None:
    points = 6.0 * grid.rays.T.astype(float)
    for i, move in enumerate(1e-3 * np.eye(6)):
        turn = Rotation.from_rotvec(move[3:]).as_matrix()
        there, _ = grid.camera.project(points @ turn.T + move[:3])
        here, _ = grid.camera.project(points)
        expected = 1e-3 * grid.motion[i].T / (6.0 if i < 3 else 1.0)
        np.testing.assert_allclose(there - here, expected, atol=2e-4)


@pytest.mark.parametrize("view", [3, 20, 44, 57])
def test_a_pose_off_by_half_a_millimeter_and_four_degrees_is_found(
    view: int, fine: Vid, phantom: Kidney, refiner: Refiner
) -> None:
    T = fine.T_kidney_camera[view]
    start = pushed(T, np.random.default_rng(view), 0.5, 4.0)
    found = refiner.refine(features(fine, phantom, T), [start])
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]) < 0.3
    assert np.degrees(rotation_angle(found.T_kidney_camera, T)) < 2.0
    assert found.score > 0.9


def test_a_light_beside_the_lens_is_found_with_the_pose(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    T = fine.T_kidney_camera[3]
    seen = features(fine, phantom, T, HeadLight(offset_mm=(1.2, -0.6, 0.0)))
    found = refiner.refine(seen, [pushed(T, np.random.default_rng(1), 0.7, 4.0)])
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]) < 0.15
    np.testing.assert_allclose(found.light[:2], [1.2, -0.6], atol=0.4)


def test_murky_water_draws_no_pose_ahead(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    """A deep wall looks bright through it, as if it were near."""
    renderer, murk = RaycastRenderer(phantom.mesh, fine.camera), SensorFaults(light=LightFaults(turbidity_per_mm=0.1))
    ahead, glow = [], []
    for view in range(0, 60, 4):
        T = fine.T_kidney_camera[view]
        seen = fine.extractor().extract(simulate(renderer, T, murk, np.random.default_rng(view)))
        found = refiner.refine(seen, [pushed(T, np.random.default_rng(view), 0.5, 3.0)])
        ahead.append((inverse(T) @ found.T_kidney_camera)[2, 3])
        glow.append(found.light[5])
    assert abs(np.median(ahead)) < 0.15
    assert np.median(glow) > 0.1


def test_under_a_known_lamp_the_waters_glow_is_found_alone(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    T = fine.T_kidney_camera[20]
    murk = SensorFaults(light=LightFaults(turbidity_per_mm=0.1))
    image = simulate(RaycastRenderer(phantom.mesh, fine.camera), T, murk, np.random.default_rng(0))
    lamp = AT_CAMERA + np.array([0.5, 0.0, 0.0, 1.0, 0.02, 0.0])
    known = refiner.refine(fine.extractor().extract(image), [T], Expectation(lamp, light_known=True))
    np.testing.assert_array_equal(known.light[:-1], lamp[:-1])
    assert known.light[-1] > 0.1


def test_the_hypothesis_that_fits_wins(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    T = fine.T_kidney_camera[3]
    near = pushed(T, np.random.default_rng(2), 0.5, 3.0)
    found = refiner.refine(features(fine, phantom, T), [fine.T_kidney_camera[30], fine.T_kidney_camera[60], near])
    assert found.hypothesis == 2
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]) < 0.1


def test_the_better_half_goes_on_best_first_and_none_that_is_far_below() -> None:
    def left(*scores: float, odds: list[float] | None = None) -> list[int]:
        states = [(i, Aligned(np.eye(4), AT_CAMERA, s, 1)) for i, s in enumerate(scores)]
        return [i for i, _ in _better_half(states, None if odds is None else np.array(odds), None)]

    assert left(0.70, 0.72, 0.69, 0.71) == [1, 3]
    assert left(0.70, 0.72, 0.71) == [1, 2]
    assert left(0.70, 0.40, 0.30, 0.20) == [0]
    assert left(-1.0) == [0]
    assert left(0.70, 0.72, 0.69, 0.71, odds=[3.0, -2.0, 1.0, 0.0]) == [0, 2]  # verified: the scores have no say
    assert left(0.70, 0.72, odds=[5.0, 0.0]) == [0]


def test_what_is_known_of_poses_beforehand_counts_where_they_are_ranked(
    fine: Vid, phantom: Kidney, refiner: Refiner
) -> None:
    T, other = fine.T_kidney_camera[3], fine.T_kidney_camera[30]
    seen = features(fine, phantom, T)

    def elsewhere(poses: np.ndarray) -> np.ndarray:
        return -2.0 * (np.linalg.norm(poses[:, :3, 3] - other[:3, 3], axis=1) > 3.0)

    plain, told = (refiner.refine(seen, [T, other], Expectation(prior=prior)) for prior in (None, elsewhere))
    assert (plain.hypothesis, told.hypothesis) == (0, 1)
    assert told.score < plain.score <= 1.0  # the score is the picture's alone


def test_hypotheses_that_end_at_one_pose_are_aligned_finely_once(
    fine: Vid, phantom: Kidney, refiner: Refiner, monkeypatch: pytest.MonkeyPatch
) -> None:
    T, counts = fine.T_kidney_camera[3], []
    rng = np.random.default_rng(3)
    starts = [pushed(T, rng, 0.3, 2.0) for _ in range(4)]
    aligned = refiner.finely
    monkeypatch.setattr(
        refiner,
        "finely",
        lambda f, states, *how, **last: (counts.append(len(states)), aligned(f, states, *how, **last))[1],
    )
    for same_mm in (0.0, 0.3):
        found = refiner.refine(features(fine, phantom, T), starts, Expectation(same_mm=same_mm, same_deg=2.0))
        assert np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]) < 0.3 and len(found.tried) >= 3
    rounds = refiner.settings.fine_rounds
    assert counts[0] >= 2 and counts[rounds] == 1


def test_a_refined_pose_is_scored_for_other_features_as_if_drawn_there(
    fine: Vid, phantom: Kidney, refiner: Refiner
) -> None:
    T = fine.T_kidney_camera[3]
    found = refiner.refine(features(fine, phantom, T), [pushed(T, np.random.default_rng(2), 0.5, 3.0)])
    same = refiner.score(features(fine, phantom, T), found)
    other = refiner.score(features(fine, phantom, fine.T_kidney_camera[30]), found)
    assert same == pytest.approx(found.score, abs=0.02) and other < 0.5 * same


def test_the_pose_never_leaves_the_lumen(fine: Vid, phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    settings = RefinementSettings(hypotheses=1, fine_rounds=1, clearance_mm=0.8)
    refiner, rng = Refiner(fine, settings), np.random.default_rng(5)
    seen = features(fine, phantom, fine.T_kidney_camera[3])
    for T in fine.T_kidney_camera[::9]:
        start = pushed(T, rng, 0.2, 20.0)
        least = min(0.8, phantom_lumen.clearance_mm(start[:3, 3])[0])
        found = refiner.refine(seen, [start]).T_kidney_camera
        assert phantom_lumen.clearance_mm(found[:3, 3])[0] >= least - 1e-6
        np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-9)


def test_a_start_outside_the_kidney_is_no_crash(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    T = fine.T_kidney_camera[3]
    outside = transform_from(np.eye(3), phantom.mesh.bounds[1] + 50)
    found = refiner.refine(features(fine, phantom, T), [outside, T])
    assert found.hypothesis == 1
    alone = refiner.refine(features(fine, phantom, T), [outside])
    assert alone.score == -1.0
    np.testing.assert_array_equal(alone.T_kidney_camera, outside)


def test_what_cannot_be_refined_is_refused(fine: Vid, phantom: Kidney, refiner: Refiner) -> None:
    seen = features(fine, phantom, fine.T_kidney_camera[3])
    with pytest.raises(InputError, match="at least one candidate"):
        refiner.refine(seen, [])
    with pytest.raises(InputError, match="not orthonormal"):
        refiner.refine(seen, [2 * np.eye(4)])
    with pytest.raises(InputError, match="fine_rounds"):
        RefinementSettings(fine_rounds=0)
    with pytest.raises(InputError, match="features=default"):
        Refiner(replace(fine, settings=ThesisSettings()))
