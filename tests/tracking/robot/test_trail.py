"""The way in told again on the way out: marks, the swing of the bend, and walls that hold the tip."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from ursnav_torch.geometry import Array, inverse
from ursnav_torch.kinematics import Segment
from ursnav_torch.tracking.robot.odometry import Odometry, OdometryReading, OdometrySettings
from ursnav_torch.tracking.robot.trail import ShaftTrail

SEGMENT = Segment()
NO_PLAY = OdometrySettings(insertion_plays_mm=(0.0,), bend_plays_deg=(0.0,))


class Room:
    """A lumen without walls, or with one at x = 2."""

    def __init__(self, wall: bool = False) -> None:
        self.wall = wall

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        points = np.asarray(points_mm, float).reshape(-1, 3)
        return 2.0 - points[:, 0] if self.wall else np.full(len(points), 9.0)


def trail(room: Room, settings: OdometrySettings = NO_PLAY, scale: float = 1.0) -> tuple[ShaftTrail, Odometry]:
    odometry = Odometry(settings)
    odometry.carried(OdometryReading(0.0), 0.0)
    return ShaftTrail(odometry, room, scale), odometry  # type: ignore[arg-type]


def go(odometry: Odometry, insertion: float, bend: tuple[float, float] = (0.0, 0.0)) -> None:
    odometry.carried(OdometryReading(insertion, *bend), 0.1)


def straight(z: float) -> Array:
    T = np.eye(4)
    T[2, 3] = z
    return T


def pushed_in(found: ShaftTrail, odometry: Odometry, depth: float) -> None:
    """Along z, the tip as deep as the shaft, a mark every half millimeter."""
    for z in np.arange(0.5, depth + 0.1, 0.5):
        go(odometry, z)
        found.mark(straight(z))


def test_a_shaft_that_is_pulled_goes_the_way_it_came() -> None:
    found, odometry = trail(Room())
    pushed_in(found, odometry, 6.0)
    assert found.expected() == []  # as deep as ever
    go(odometry, 3.1)
    (back,) = found.expected()
    np.testing.assert_allclose(back, straight(3.0), atol=1e-9)


def test_the_bend_has_swung_the_tip_since() -> None:
    found, odometry = trail(Room())
    pushed_in(found, odometry, 6.0)
    go(odometry, 3.0, (0.0, 0.5))
    (back,) = found.expected()
    swing = inverse(SEGMENT.point_transform([0, 0])) @ SEGMENT.point_transform([0, 0.5])
    np.testing.assert_allclose(back, straight(3.0) @ swing, atol=1e-9)
    assert back[0, 3] > 4.0


def test_a_wall_in_the_way_of_the_swing_may_hold_the_tip() -> None:
    found, odometry = trail(Room(wall=True))
    pushed_in(found, odometry, 6.0)
    go(odometry, 3.0, (0.0, 0.5))
    held, free = found.expected()
    assert held[0, 3] == pytest.approx(1.4, abs=0.2) and free[0, 3] > 4.0
    np.testing.assert_array_equal(held[:3, :3], free[:3, :3])


def test_the_sliders_play_leaves_the_shaft_deeper() -> None:
    found, odometry = trail(Room(), OdometrySettings(insertion_plays_mm=(1.0,), bend_plays_deg=(0.0,)))
    pushed_in(found, odometry, 6.0)
    go(odometry, 3.0)
    (back,) = found.expected()
    assert back[2, 3] == pytest.approx(4.0)


def test_a_new_way_in_replaces_the_old_one() -> None:
    found, odometry = trail(Room())
    pushed_in(found, odometry, 6.0)
    go(odometry, 2.0)
    found.mark(straight(99.0))  # pulled: no way in
    go(odometry, 2.9)
    found.mark(straight(50.0))
    go(odometry, 5.0)
    found.mark(straight(60.0))
    go(odometry, 4.0)
    assert found.expected()[0][2, 3] == pytest.approx(50.0)
    go(odometry, 2.2)
    assert found.expected()[0][2, 3] == pytest.approx(2.0)


def test_marks_do_not_pile_up() -> None:
    """A long session in and out remembers one way in, however often it was gone."""
    found, odometry = trail(Room())
    for _ in range(20):
        for z in [*np.arange(0.0, 5.0, 0.01), 0.0]:
            go(odometry, z)
            found.mark(straight(z))
    assert len(found._marks) <= 5.0 / 0.3 + 1
