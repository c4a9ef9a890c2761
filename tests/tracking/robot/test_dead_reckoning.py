"""A robot's word from picture to picture: when it counts, how it adds up over pictures that show nothing."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from ursnav_torch.geometry import Array
from ursnav_torch.tracking.robot.dead_reckoning import DeadReckoning
from ursnav_torch.tracking.robot.odometry import OdometryReading, OdometrySettings

NO_PLAY = OdometrySettings(insertion_plays_mm=(0.0,), bend_plays_deg=(0.0,))


class OpenRoom:
    """A lumen whose walls are far."""

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        return np.full(len(np.asarray(points_mm, float).reshape(-1, 3)), 9.0)


@pytest.fixture
def robot() -> DeadReckoning:
    return DeadReckoning(NO_PLAY, OpenRoom())  # type: ignore[arg-type]


def ahead(robot: DeadReckoning) -> float | None:
    return None if robot.carried is None else round(float(robot.carried.T_before_now[2, 3]), 6)


def straight(z: float) -> Array:
    T = np.eye(4)
    T[2, 3] = z
    return T


def test_the_first_word_tells_of_no_motion(robot: DeadReckoning) -> None:
    robot.seen()
    robot.hear(OdometryReading(30.0), 1.0)
    assert robot.step is None and robot.carried is None and robot.slider_play_mm == 0
    robot.seen()
    robot.hear(OdometryReading(31.0), 1.1)
    assert robot.step is not None and robot.step.seconds == pytest.approx(0.1) and ahead(robot) == 1


def test_motion_adds_up_while_pictures_show_nothing_and_counts_from_where_one_does(robot: DeadReckoning) -> None:
    for i in range(4):
        robot.hear(OdometryReading(float(i)), 0.1 * i)
        if i == 0:
            robot.seen()
    assert ahead(robot) == 3 and robot.step is not None and robot.carried is not None
    assert robot.carried.sd_mm > robot.step.sd_mm, "less and less sure"
    robot.seen()
    robot.hear(OdometryReading(5.0), 0.4)
    assert ahead(robot) == 2


def test_a_robot_that_falls_silent_carries_nothing_on(robot: DeadReckoning) -> None:
    """What it did meanwhile nobody knows, nor by how much it had moved when it speaks again."""
    robot.hear(OdometryReading(0.0), 0.0)
    robot.seen()
    robot.hear(None, 0.1)
    assert robot.step is None and robot.carried is None and robot.slider_play_mm is None
    robot.hear(OdometryReading(9.0), 0.2)
    assert robot.step is None and robot.carried is None
    robot.hear(OdometryReading(9.5), 0.3)
    assert robot.carried is None, "no picture has shown yet where it went on from"


def test_pictures_teach_plays_and_the_way_in() -> None:
    robot = DeadReckoning(OdometrySettings(), OpenRoom())  # type: ignore[arg-type]
    robot.hear(OdometryReading(1.0), 0.0)
    before = robot.slider_play_mm
    for i in range(1, 9):
        robot.hear(OdometryReading(1.0 + 0.5 * i), 0.1 * i)
        robot.learn(straight(0.5), 0.1, 0.01, 0.1)
        robot.mark(straight(0.5 * i))
    learned = robot.slider_play_mm
    assert learned is not None and before is not None and learned < before, "what follows at once has little play"
    robot.hear(OdometryReading(2.0), 0.9)
    assert robot.expected(), "pulled: the way it came"
    robot.reset()
    robot.hear(OdometryReading(1.0), 1.0)
    assert robot.slider_play_mm == before and not robot.expected() and robot.carried is None


def test_the_first_word_is_no_way_in(robot: DeadReckoning) -> None:
    """How the shaft came to stand there nobody saw."""
    robot.hear(OdometryReading(5.0), 0.0)
    robot.mark(straight(0.0))
    robot.hear(OdometryReading(2.0), 0.1)
    assert not robot.expected()


def test_a_step_that_was_told_before_silence_is_compared_with_no_later_picture() -> None:
    robot = DeadReckoning(OdometrySettings(), OpenRoom())  # type: ignore[arg-type]
    for i in range(2):
        robot.hear(OdometryReading(float(i)), 0.1 * i)
    before = robot.slider_play_mm
    robot.hear(None, 0.2)
    robot.learn(straight(1.0), 0.1, 0.01, 0.1)
    robot.hear(OdometryReading(1.0), 0.3)
    assert robot.slider_play_mm == before
