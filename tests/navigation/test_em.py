"""EM samples in the live navigator: from the tracker's frame to the picture that follows them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flights import hover

from ursnav_torch.devices import Frame, Stamp, TrackerSample
from ursnav_torch.errors import InputError
from ursnav_torch.navigation import Governor, Navigator
from ursnav_torch.navigation.em import sensor_in_kidney
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.tracker import Tracker

OFFSET = [0.0, 1.0, -4.0]
R_EM_TO_KIDNEY = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.fixture
def registration(tmp_path: Path) -> Path:
    path = tmp_path / "registration.json"
    path.write_text(json.dumps({"R": R_EM_TO_KIDNEY, "t_mm": [10.0, 20.0, 30.0]}))
    return path


def sample(position_mm, visible=True, number=0):
    return TrackerSample(Stamp(number, 0.0, 0.0), visible, None if position_mm is None else tuple(position_mm))


def test_a_sample_is_carried_into_the_kidney_frame_with_the_sensors_place_on_the_scope(registration):
    reading = sensor_in_kidney(registration, OFFSET)(sample([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(reading.position_mm, [8.0, 21.0, 33.0])
    np.testing.assert_allclose(reading.offset_camera_mm, OFFSET)
    assert 0.3 < reading.sigma_mm < 3.0
    assert reading.off(np.eye(4)[None])[0] == pytest.approx(
        np.linalg.norm(np.array(OFFSET) - [8.0, 21.0, 33.0]) / reading.sigma_mm
    )


def test_a_sensor_that_is_not_seen_gives_no_reading(registration):
    reading = sensor_in_kidney(registration, OFFSET)
    assert reading(sample([1.0, 2.0, 3.0], visible=False)) is None
    assert reading(sample(None)) is None


def test_what_cannot_be_used_is_refused(registration):
    with pytest.raises(InputError, match=r"\[x,y,z\] in mm in the camera frame"):
        sensor_in_kidney(registration, [1.0, 2.0])


@pytest.fixture(scope="module")
def tracker(vid):
    return Tracker(vid)


@pytest.fixture
def asked(tracker, monkeypatch):
    """The readings with which the tracker is asked."""
    tracker.reset()
    tracker.ease(0)
    readings, follow = [], tracker.follow

    def remembering(features, t_s, sensor=None, *more):
        readings.append(sensor)
        return follow(features, t_s, sensor, *more)

    monkeypatch.setattr(tracker, "follow", remembering)
    return readings


def reading_of(event):
    return SensorReading(np.asarray(event.position_mm, float), np.zeros(3), 0.5) if event.visible else None


def test_every_picture_is_located_with_the_newest_reading_before_it(tracker, asked, vid, renderer):
    images = [renderer.render(T).image for T in hover(vid, 0, 4)]
    with Navigator(tracker, sensor=reading_of, governor=Governor(budget_s=1e9)) as navigator:
        for i, image in enumerate(images):
            if i in (1, 2):
                navigator.take(sample([-1.0, 0.0, 0.0], number=2 * i))
                navigator.take(sample([float(i), 0.0, 0.0], number=2 * i + 1))
            if i == 3:
                navigator.take(sample(None, visible=False, number=9))
            navigator.take(Frame(Stamp(i, i / 10, 0.0), image))
            assert navigator.wait(60.0)
    assert asked[0] is None and asked[3] is None
    assert [asked[i].position_mm[0] for i in (1, 2)] == [1.0, 2.0]


def test_a_reading_draws_the_pose_that_is_published(tracker, asked, vid, renderer):
    poses, published = hover(vid, 0, 6), {}
    for aside_mm in (0.0, 1.0):
        tracker.reset()
        with Navigator(tracker, sensor=reading_of, governor=Governor(budget_s=1e9)) as navigator:
            for i, T in enumerate(poses):
                navigator.take(sample(T[:3, 3] + aside_mm * T[:3, 0], number=i))
                navigator.take(Frame(Stamp(i, i / 10, 0.0), renderer.render(T).image))
                assert navigator.wait(60.0)
            state = navigator.bus.latest()
        assert state.tracking == "tracking"
        published[aside_mm] = state.T_kidney_camera[:3, 3] @ poses[-1][:3, 0]
    assert 0.2 < published[1.0] - published[0.0] < 1.0


def test_without_a_registration_samples_are_passed_by(tracker, asked, vid, renderer):
    frame = Frame(Stamp(0, 0.0, 0.0), renderer.render(vid.T_kidney_camera[0]).image)
    with Navigator(tracker, governor=Governor(budget_s=1e9)) as navigator:
        navigator.take(sample([1.0, 0.0, 0.0]))
        navigator.take(replace(frame, stamp=Stamp(1, 0.1, 0.0)))
        assert navigator.wait(60.0)
    assert asked == [None]
