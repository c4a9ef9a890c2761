"""A recording followed both ways: better than live, and nothing lost on the way."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney
from ursnav_torch.localization.smooth import SmoothSettings
from ursnav_torch.localization.smooth_offline import Measured, smooth_stretch
from ursnav_torch.localization.track import SEARCHING, TRACKING, Tracked, Tracker
from ursnav_torch.localization.track_offline import follow_both_ways
from ursnav_torch.localization.track_video import Moment, Source, follow_source
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

POSES = 18


@pytest.fixture(scope="module")
def poses(phantom: Kidney) -> np.ndarray:
    """(18, 4, 4) on the way to a calyx."""
    points = phantom.centerline.points_mm[phantom.centerline.path_to(1)]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    stations = along[-1] - 18.0 + 0.7 * np.arange(POSES)
    at, ahead = (np.stack([np.interp(stations + d, along, points[:, i]) for i in range(3)], 1) for d in (0, 4))
    return look_along(at, ahead - at, np.zeros(POSES))


@pytest.fixture(scope="module")
def source(poses: np.ndarray, renderer: RaycastRenderer) -> Source:
    """Noisy pictures, three of them all white."""
    rng = np.random.default_rng(0)
    images = [
        np.clip(renderer.render(T).image + rng.normal(0, 4, renderer.render(T).image.shape), 0, 255).astype(np.uint8)
        for T in poses
    ]
    for i in (7, 8, 9):
        images[i] = np.full_like(images[i], 255)
    moments = [Moment(i, i / 10, image, str(i)) for i, image in enumerate(images)]
    return Source(lambda: iter(moments), len(moments), "pictures")


def off(answers: list[Tracked], poses: np.ndarray) -> np.ndarray:
    return np.array([np.linalg.norm(a.T_kidney_camera[:3, 3] - T[:3, 3]) for a, T in zip(answers, poses, strict=True)])


def test_hindsight_knows_the_first_pictures_and_those_that_show_nothing(
    vid: Vid, source: Source, poses: np.ndarray
) -> None:
    live = [answer for _, answer in follow_source(Tracker(vid), source)]
    steps: list[int] = []
    found = list(follow_both_ways(Tracker(vid), source, advance=steps.append))
    moments, answers = [m for m, _ in found], [a for _, a in found]
    assert sum(steps) == 2 * POSES
    assert [m.frame for m in moments] == list(range(POSES)) and moments[3].image.size == 0
    assert live[0].state == SEARCHING and all(a.state == TRACKING for a in answers)
    apart = off(answers, poses)
    assert np.median(apart) < 0.6 and apart.max() < 2.0
    assert np.isnan(answers[8].score) and apart[8] < 1.5
    assert all(0 < a.confidence <= 1 for a in answers)


def test_the_way_back_sees_what_the_way_there_saw(vid: Vid, source: Source) -> None:
    tracker = Tracker(vid)
    features = tracker.extract(next(source.moments()).image)
    assert features is not None
    again = tracker.recall(features.fields[0])
    np.testing.assert_array_equal(again.maps, features.maps)
    np.testing.assert_array_equal(again.fields, features.fields)


def test_an_interruption_gives_the_live_answers_so_far(vid: Vid, source: Source) -> None:
    def broken_off() -> Iterator[Moment]:
        for moment in source.moments():
            if moment.frame == 4:
                raise KeyboardInterrupt
            yield moment

    answers = follow_both_ways(Tracker(vid), replace(source, moments=broken_off))
    assert [next(answers)[0].frame for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(KeyboardInterrupt):
        next(answers)


def test_no_pictures_give_no_answers_and_a_camera_is_refused(vid: Vid, source: Source) -> None:
    assert list(follow_both_ways(Tracker(vid), replace(source, moments=lambda: iter(())))) == []
    with pytest.raises(InputError, match="offline=true needs a recording"):
        next(follow_both_ways(Tracker(vid), replace(source, live=True)))


def test_a_smoothed_stretch_is_steadier_and_fills_its_gaps() -> None:
    rng, t_s = np.random.default_rng(0), np.arange(40) / 10
    true = look_along(np.stack([5 * t_s, np.sin(t_s), 0 * t_s], 1), np.tile([1.0, 0.2, 0.0], (40, 1)), np.zeros(40))
    noisy = true.copy()
    noisy[:, :3, 3] += rng.normal(0, 0.35, (40, 3))
    measured = [None if 15 <= i < 20 else Measured(T, 0.75) for i, T in enumerate(noisy)]
    smooth = np.array(smooth_stretch(measured, t_s.tolist(), SmoothSettings(), 1.0))
    error = np.linalg.norm(smooth[:, :3, 3] - true[:, :3, 3], axis=1)
    assert np.median(error) < 0.6 * np.median(np.linalg.norm(noisy[:, :3, 3] - true[:, :3, 3], axis=1))
    assert error[15:20].max() < 1.0
    np.testing.assert_allclose(
        smooth[:, :3, :3] @ np.swapaxes(smooth[:, :3, :3], 1, 2), np.tile(np.eye(3), (40, 1, 1)), atol=1e-9
    )


def test_a_position_known_besides_draws_the_track_to_it() -> None:
    T = np.eye(4)
    plain = [Measured(T, 0.6)] * 5
    drawn = [Measured(T, 0.6, ((np.array([1.0, 0, 0]), 0.2),))] * 5
    t_s = [i / 10 for i in range(5)]
    alone, with_it = (smooth_stretch(m, t_s, SmoothSettings(), 1.0)[2][0, 3] for m in (plain, drawn))
    assert alone == pytest.approx(0.0) and 0.7 < with_it < 1.0
