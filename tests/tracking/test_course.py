"""The course of a track: what is followed at once, what is coasted past, and what begins it anew."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.geometry import transform_from
from ursnav_torch.tracking.course import Course
from ursnav_torch.tracking.robot.odometry import Carried
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, TrackSettings

HERE = np.eye(4)
FAR, ASIDE = (transform_from(np.eye(3), np.array(at)) for at in ([8.0, 0.0, 0.0], [0.0, 8.0, 0.0]))


def settled() -> Course:
    """A course that has stood still for a second."""
    course = Course(TrackSettings())
    for n in range(11):
        course.follow(HERE, 0.9, n / 10, None, (HERE,))
    return course


def follow(course: Course, t_s: float, score: float = 0.7, told: tuple[np.ndarray, ...] = (HERE,)) -> tuple[bool, bool]:
    """Whether it goes to where a picture's alignment is, and leaps there."""
    T, leapt = course.follow(FAR, score, t_s, None, told)
    return bool(np.linalg.norm(T[:3, 3] - FAR[:3, 3]) < 1.0), leapt


@pytest.mark.parametrize(
    ("score", "told", "goes", "leapt"),
    [
        (0.7, (HERE,), False, False),  # coasts
        (0.9, (HERE,), True, False),  # aligned too well not to be believed
        (0.7, (), True, False),  # no robot told
        (0.3, (), False, False),  # nor is anybody believed whose picture fits badly
        (0.7, (HERE, FAR), True, False),  # the shaft's way leads there
    ],
)
def test_what_fits_or_was_foreseen_is_followed_at_once(score, told, goes, leapt) -> None:
    course = settled()
    assert follow(course, 1.1, score, told) == (goes, leapt)
    assert course.coasts is (score == 0.7 and told == (HERE,))


@pytest.mark.parametrize(("score", "leapt"), [(0.7, False), (0.6, True)])
def test_after_a_second_of_coasting_it_goes_where_pictures_say_and_a_bad_one_leaps(score, leapt) -> None:
    course = settled()
    for n in range(10):
        T, leaps = course.follow((FAR, ASIDE)[n % 2], score, 1.1 + n / 10, None, (HERE,))
        assert np.linalg.norm(T[:3, 3]) < 1.0 and not leaps and course.coasts
    assert follow(course, 2.2, score) == (True, leapt) and not course.coasts


@pytest.mark.parametrize(("score", "believed"), [(0.7, True), (0.5, True), (0.4, False)])
def test_alignments_that_follow_each_other_are_believed_sooner_and_are_no_leap(score, believed) -> None:
    """A tip that its play has let go, or a track that had slipped: all pictures say where it is now."""
    course = settled()
    assert [follow(course, 1.1 + n / 10, score) for n in range(3)] == [(False, False)] * 3 and course.coasts
    assert follow(course, 1.4, score) == (believed, False) and course.coasts is not believed


@pytest.mark.parametrize("shown", [(True, True, True, True, True), (True, False, True, False, True)])
def test_alignments_that_stand_while_the_robot_moves_do_not_follow_each_other(shown) -> None:
    """Nor where a picture between two of them shows nothing."""
    course, ahead = settled(), transform_from(np.eye(3), np.array([0.0, 0.0, 2.0 if False in shown else 5.0]))
    for n, is_shown in enumerate(shown):
        here = course.predict(1.1 + n / 10, Carried(ahead, 0.1, 0.01, 0.1))
        assert here is not None
        assert not is_shown or follow(course, 1.1 + n / 10, 0.6, (here,)) == (False, False)
    assert course.coasts


def test_what_was_not_seen_for_long_does_not_persist() -> None:
    course = settled()
    assert follow(course, 1.1) == (False, False) and follow(course, 1.5) == (False, False) and course.coasts


def test_a_sensor_is_heard_while_it_coasts() -> None:
    course = settled()
    at = SensorReading(np.array([0.5, 0.0, 0.0]), np.zeros(3), 0.3)
    T, _ = course.follow(FAR, 0.7, 1.1, at, (HERE,))
    assert course.coasts and 0.02 < T[0, 3] < 0.5
    pose = course.pose()
    assert pose is not None and pose[0, 3] == pytest.approx(T[0, 3])


def test_where_alignments_come_back_coasting_ends_and_begins_anew() -> None:
    course = settled()
    assert not follow(course, 1.1)[0]
    course.follow(HERE, 0.7, 1.2, None, (HERE,))
    assert not course.coasts
    assert follow(course, 2.15) == (False, False), "a second counts from the last that was believed"


def test_what_cannot_be_aligned_is_not_followed_even_after_a_second() -> None:
    course, s = settled(), ChallengerSettings()
    bad = (s.reacquire_below + s.leap_above) / 2
    assert [follow(course, 1.1 + n / 5, bad)[0] for n in range(10)] == [False] * 10 and course.coasts


def test_a_course_that_is_forgotten_coasts_no_more() -> None:
    course = settled()
    follow(course, 1.1)
    course.reset()
    assert not course.coasts and course.pose() is None
    assert follow(course, 1.2) == (True, False)


def test_without_coasting_a_leap_is_made_at_once() -> None:
    settings = TrackSettings()
    course = Course(replace(settings, challenger=replace(settings.challenger, coast_s=0.0)))
    course.follow(HERE, 0.9, 0.0, None, (HERE,))
    assert follow(course, 0.1, 0.6) == (True, True)


def test_where_no_robot_can_have_brought_it_a_track_does_not_go_however_long() -> None:
    course = settled()
    for n in range(40):
        T, leapt = course.follow(FAR, 0.9, 1.1 + n / 10, None, (HERE,), reached=False)
        assert np.linalg.norm(T[:3, 3]) < 1.0 and not leapt and course.coasts
    T, leapt = course.follow(FAR, 0.9, 5.2, None, (HERE, FAR), reached=False)
    assert np.linalg.norm(T[:3, 3] - FAR[:3, 3]) < 1.0 and not course.coasts  # where its shaft's way leads it goes
