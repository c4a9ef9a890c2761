"""A recording followed both ways: better than live, and nothing lost on the way."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from flights import ahead_by, flight

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.follow import Moment, Source, follow_source
from ursnav_torch.tracking.offline import follow_both_ways, join
from ursnav_torch.tracking.reading import planes_of, recalled
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.smooth import Measured, SmoothSettings, smooth_stretch
from ursnav_torch.tracking.tracker import LOST, SEARCHING, TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid

POSES = 18


@pytest.fixture(scope="module")
def poses(phantom: Kidney) -> np.ndarray:
    """(18, 4, 4) on the way to a calyx."""
    return flight(phantom, 1, from_mm=18.0, to_mm=5.4, step_mm=0.7)[:POSES]


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


@pytest.fixture(scope="module")
def tracker(vid: Vid) -> Tracker:
    return Tracker(vid)


def answer(T: np.ndarray, score: float = 0.7, state: str = TRACKING, shown: bool = True) -> Tracked:
    """One way's answer; a picture that showed nothing is bridged."""
    tracking = state == TRACKING
    return Tracked(
        state, T if tracking else None, 1 if tracking else -1, 0.9 if tracking else 0.0, 1.2,
        score if shown else np.nan, 0.05, T if shown else None,
    )  # fmt: skip


def joined(tracker: Tracker, forward: list[Tracked], backward: list[Tracked], sensor: object = None) -> list[Tracked]:
    readings = [sensor if isinstance(sensor, SensorReading) else None] * len(forward)
    return join(forward, backward, [i / 10 for i in range(len(forward))], tracker, readings)


def test_the_way_back_judges_and_each_way_fills_what_the_other_did_not_find(
    tracker: Tracker, poses: np.ndarray
) -> None:
    ways = {
        (LOST, TRACKING): TRACKING,
        (TRACKING, LOST): LOST,
        (TRACKING, SEARCHING): TRACKING,
        (SEARCHING, SEARCHING): SEARCHING,
    }
    for (there, back), state in ways.items():
        forward = [answer(T, state=there) for T in poses[:4]]
        found = joined(tracker, forward, [answer(T, state=back) for T in poses[:4]])
        assert {a.state for a in found} == {state}, (there, back)
        assert [a.T_kidney_camera is None for a in found] == [state != TRACKING] * 4
        assert found[0].seconds == pytest.approx(0.1)


def test_of_two_poses_the_better_aligned_counts_unless_motion_forbids_it(tracker: Tracker, poses: np.ndarray) -> None:
    right = [answer(T, 0.7) for T in poses[:9]]
    slipped = [answer(ahead_by(T, -6.0), 0.6) for T in poses[:9]]
    assert off(joined(tracker, slipped, right), poses[:9]).max() < 0.6
    leap = [*right[:4], answer(ahead_by(poses[4], -6.0), 0.72), *right[5:]]
    dull = [*right[:4], answer(poses[4], 0.68), *right[5:]]
    assert off(joined(tracker, leap, dull), poses[:9]).max() < 0.6
    assert off(joined(tracker, dull, leap), poses[:9]).max() < 0.6


def test_the_sensor_says_which_of_two_poses(tracker: Tracker, poses: np.ndarray) -> None:
    T = poses[5]
    reading = SensorReading(ahead_by(T, -6.0)[:3, 3], np.zeros(3), 0.8)
    right, aside = [answer(T, 0.71)] * 5, [answer(ahead_by(T, -6.0), 0.7)] * 5
    plain, told = joined(tracker, right, aside), joined(tracker, right, aside, reading)
    assert off(plain, [T] * 5).max() < 1.0 and off(told, [ahead_by(T, -6.0)] * 5).max() < 1.0


def test_pictures_that_show_nothing_are_filled_between_seen_ones_only(tracker: Tracker, poses: np.ndarray) -> None:
    seen = [answer(T) for T in poses[:3]]
    blank = [answer(poses[0], shown=False)] * 4
    last = [answer(T) for T in poses[7:10]]
    between = joined(tracker, [*seen, *blank, *last], [*seen, *blank, *last])
    assert off(between, poses[:10]).max() < 1.5
    unbelieved = joined(
        tracker, [*[answer(T) for T in poses[:3]], *blank], [*[answer(T, state=LOST) for T in poses[:3]], *blank]
    )
    assert {a.state for a in unbelieved[3:]} == {SEARCHING} and all(a.T_kidney_camera is None for a in unbelieved)
    assert joined(tracker, [], []) == []


def off(answers: list[Tracked], poses: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    return np.array([np.linalg.norm(a.T_kidney_camera[:3, 3] - T[:3, 3]) for a, T in zip(answers, poses, strict=True)])


def test_hindsight_knows_the_first_pictures_and_those_that_show_nothing(
    vid: Vid, source: Source, poses: np.ndarray
) -> None:
    live = [found for _, found in follow_source(Tracker(vid), source)]
    steps: list[int] = []
    found = list(follow_both_ways(Tracker(vid), source, advance=steps.append))
    moments, answers = [m for m, _ in found], [a for _, a in found]
    assert sum(steps) == 2 * POSES
    assert [m.frame for m in moments] == list(range(POSES)) and moments[3].image.size == 0
    assert live[0].state == SEARCHING and all(a.state == TRACKING for a in answers)
    apart, known = off(answers, poses), [i for i, a in enumerate(live) if a.T_kidney_camera is not None]
    assert np.median(apart) < 0.6 and apart.max() < 2.0
    assert np.mean(apart[known]) <= np.mean(off([live[i] for i in known], poses[known]))
    assert np.isnan(answers[8].score) and apart[8] < 1.5
    assert all(0 < a.confidence <= 1 for a in answers)


def test_the_way_back_sees_what_the_way_there_saw(vid: Vid, source: Source) -> None:
    tracker = Tracker(vid)
    features = tracker.extract(next(source.moments()).image)
    assert features is not None
    for valid in (features.valid, torch.rand(features.fields.shape[1:])):
        again = recalled(planes_of(replace(features, valid=valid)))
        np.testing.assert_array_equal(again.maps, features.maps)
        np.testing.assert_array_equal(again.fields, features.fields)
        np.testing.assert_array_equal(again.valid, valid)


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
    smooth = np.array(smooth_stretch(measured, t_s.tolist(), SmoothSettings()))
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
    alone, with_it = (smooth_stretch(m, t_s, SmoothSettings())[2][0, 3] for m in (plain, drawn))
    assert alone == pytest.approx(0.0) and 0.7 < with_it < 1.0
