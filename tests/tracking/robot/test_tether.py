"""How far a robot's word lets a scope be from where it was last surely seen, and what breaks that word."""

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, transform_from
from ursnav_torch.tracking.robot.tether import Tether, TetherSettings

SETTINGS = TetherSettings(reach_mm=6.0, reach_share=0.5, sure_above=0.65, release_s=3.0, beyond_score=0.15)


def at(x: float, z: float = 0.0) -> Array:
    return transform_from(np.eye(3), np.array([x, 0.0, z]))


def tied(score: float = 0.9, believed: bool = True) -> Tether:
    """One that has seen the scope at the origin."""
    tether = Tether(SETTINGS, 3.0, 25.0)
    tether.carry(np.eye(4))
    tether.see(at(0.0), score, 0.0, believed)
    return tether


def test_nothing_binds_before_a_sure_place() -> None:
    for tether in (tied(score=0.6), tied(believed=False), Tether(SETTINGS, 3.0, 25.0)):
        assert not tether.binds and tether.reaches(at(40.0))
        np.testing.assert_array_equal(tether.against(np.stack([at(0.0), at(40.0)])), [0.0, 0.0])


def test_it_reaches_farther_the_more_the_tip_was_driven_and_goes_along() -> None:
    tether = tied()
    assert tether.binds and tether.reaches(at(5.9)) and not tether.reaches(at(6.1))
    for _ in range(4):
        tether.carry(at(0.0, 2.0))
    assert tether.reaches(at(9.9, 8.0)) and not tether.reaches(at(10.1, 8.0)) and not tether.reaches(at(0.0, -3.0))
    np.testing.assert_allclose(tether.against(np.stack([at(0.0, 8.0), at(20.0)])), [0.0, 0.15])
    tether.see(at(9.0, 8.0), 0.9, 1.0, believed=True)
    assert tether.reaches(at(14.9, 8.0)) and not tether.reaches(at(0.0, 8.0))  # what was driven is forgotten


@pytest.mark.parametrize(("score", "believed"), [(0.6, True), (0.9, False)])
def test_only_a_sure_place_ties_it_anew(score, believed) -> None:
    tether = tied()
    tether.see(at(5.0), score, 0.1, believed)
    assert not tether.reaches(at(10.0))


def test_a_robot_that_falls_silent_binds_no_more() -> None:
    tether = tied()
    tether.carry(None)
    assert not tether.binds and tether.reaches(at(40.0))


def test_good_places_out_of_reach_that_follow_each_other_break_it() -> None:
    tether = tied()
    for n in range(31):
        tether.carry(at(0.0, 0.2))
        assert not tether.reaches(at(40.0, 0.2 * n))
        tether.see(at(40.0, 0.2 * n), 0.7, n / 10, believed=False)
    assert not tether.binds


@pytest.mark.parametrize("other", [(at(0.0), 0.9), (at(40.0), 0.6), (at(-40.0), 0.9)])
def test_a_place_in_reach_a_bad_one_or_another_one_makes_it_begin_again(other) -> None:
    """At 2 s of 3."""
    tether = tied()
    for n in range(41):
        tether.carry(np.eye(4))
        T, score = other if n == 20 else (at(40.0), 0.7)
        tether.see(T, score, n / 10, believed=False)
    assert tether.binds


@pytest.mark.parametrize("name", ["reach_mm", "reach_share", "release_s", "beyond_score"])
def test_settings_without_a_meaning_are_refused(name) -> None:
    with pytest.raises(InputError, match="reach_mm > 0, and reach_share, release_s and beyond_score"):
        TetherSettings(**{name: -0.1})
