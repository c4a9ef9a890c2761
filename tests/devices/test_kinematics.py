"""Bend, cables, motor steps and tip pose: conventions, round trips, and the integral of the curve."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ursnav_torch.devices import Drive, Joints, Segment, tip_transform
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import check_rigid
from ursnav_torch.kinematics import turn_towards

SEGMENT, DRIVE = Segment(), Drive()
bends = st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))


def test_convention_a_positive_bend_about_x_looks_to_minus_y():
    T = tip_transform(SEGMENT, Joints(math.pi / 2, 0.0, 5.0))
    np.testing.assert_allclose(T[:3, 2], [0, -1, 0], atol=1e-12)
    r = 20 / (math.pi / 2)  # the radius of a quarter circle of 20 mm
    np.testing.assert_allclose(T[:3, 3], [0, -r, r + 5.0], atol=1e-9)


def test_convention_straight_looks_along_z():
    np.testing.assert_allclose(tip_transform(SEGMENT, Joints(insertion_mm=3.0))[:3, 3], [0, 0, 23.0])


@given(bends)
def test_the_tip_is_the_integral_of_the_curves_directions(bend):
    s = np.linspace(0, 1, 2001)
    z = Rotation.from_rotvec(np.outer(s, [*bend, 0.0])).apply([0, 0, 1])
    T = check_rigid(SEGMENT.point_transform(bend), "T")
    np.testing.assert_allclose(T[:3, 3], 20 * np.trapezoid(z, s, axis=0), atol=1e-4)
    np.testing.assert_allclose(T[:3, 2], z[-1], atol=1e-9)


@given(bends, st.floats(0, 1))
def test_the_curve_can_be_walked_in_two_parts(bend, share):
    first = SEGMENT.point_transform(bend, share * 20)
    rest = SEGMENT.point_transform(bend, (1 - share) * 20)
    np.testing.assert_allclose(first @ rest, SEGMENT.point_transform(bend), atol=1e-9)


@given(bends)
def test_a_pull_shortens_the_named_cable_along_its_curve(bend):
    """Second way: follow each + cable's points along the bent segment and add up the steps."""
    places = 2.0 * np.array([[0, -1, 0], [1, 0, 0]])
    curve = np.stack([SEGMENT.point_transform(bend, s) for s in np.linspace(0, 20, 101)])
    for place, pull in zip(places, SEGMENT.pulls_mm(bend), strict=True):
        way = curve[:, :3, :3] @ place + curve[:, :3, 3]
        assert 20 - np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(pull, abs=1e-3)


@given(bends, st.floats(0, 120))
def test_bends_survive_steps(bend, insertion):
    joints = Joints(*bend, insertion)
    back = DRIVE.joints_from_steps(DRIVE.steps(joints))
    assert back.bend_x_rad == pytest.approx(bend[0], abs=0.5 / 528 / 2 + 1e-9)
    assert back.insertion_mm == pytest.approx(insertion, abs=0.5 / 400 + 1e-9)


def test_impossible_segments_are_refused():
    with pytest.raises(InputError, match="length_mm must be positive"):
        Segment(length_mm=0)


@given(bends, st.floats(-3.0, 3.0))
def test_a_change_of_bend_turns_the_tip_as_asked(bend, direction):
    turn = 0.01 * np.array([math.cos(direction), math.sin(direction)])
    change = SEGMENT.bend_for_turn(bend, turn)
    before, after = SEGMENT.point_transform(bend), SEGMENT.point_transform(np.add(bend, change))
    made = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
    np.testing.assert_allclose(made[:2], turn, atol=5e-4)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_the_turn_towards_a_direction_ends_there(direction):
    size = np.linalg.norm(direction)
    if size < 1e-3:
        return
    turned = Rotation.from_rotvec([*turn_towards(direction), 0.0]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, np.divide(direction, size), atol=1e-6)


def test_straight_behind_is_half_a_turn_and_straight_ahead_none():
    assert np.linalg.norm(turn_towards([0.0, 0.0, -1.0])) == pytest.approx(math.pi)
    assert not turn_towards([0.0, 0.0, 2.0]).any()


@given(bends)
def test_the_rotation_of_a_bend_is_that_of_its_rotation_vector(bend):
    np.testing.assert_allclose(
        SEGMENT.point_transform(bend)[:3, :3], Rotation.from_rotvec([*bend, 0.0]).as_matrix(), atol=1e-12
    )
