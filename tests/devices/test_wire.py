"""Numbers from devices: not seen, refused, or fit to compute with; never anything that an SVD could hang on."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ursnav_torch.devices import Stamp
from ursnav_torch.devices.igtl.messages import unpack_position, unpack_transform
from ursnav_torch.devices.wire import FARTHEST_MM, SensorPose, Tool, device_number, device_numbers
from ursnav_torch.errors import DeviceProtocolError

NOW = Stamp(0, 0.0, 0.0)
HERE = [1.0, 2.0, 3.0]
any_float = st.floats(width=32)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", range(12))
def test_a_transform_with_one_number_that_is_none_is_a_sensor_not_seen(bad, at):
    values = np.append(np.eye(3).ravel(), HERE)
    values[at] = bad
    assert unpack_transform(values.astype(">f4").tobytes()) is None


def test_all_zero_and_ndis_word_for_no_number_are_a_sensor_not_seen():
    assert unpack_transform(bytes(48)) is None
    assert SensorPose.from_quaternion([0, 0, 0, 0], HERE) is None
    assert unpack_position(struct.pack(">7f", -3.697314e28, 0, 0, 0, 0, 0, 1)) is None
    assert SensorPose.from_matrix(np.eye(3), [0, 0, 1.001 * FARTHEST_MM]) is None
    assert SensorPose.from_matrix(np.eye(3), [-9999.0] * 3) is None


@pytest.mark.parametrize("R", [2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3)), np.diag([1.0, 1.0, 0.0])])
def test_finite_numbers_that_are_no_rotation_are_refused(R):
    with pytest.raises(DeviceProtocolError, match="orthonormal"):
        SensorPose.from_matrix(R, HERE)
    with pytest.raises(DeviceProtocolError, match="length 1"):
        SensorPose.from_quaternion([0.5, 0.5, 0.5, 0.1], HERE)


def test_a_pose_is_what_was_sent():
    turn = Rotation.from_quat([0.1, -0.2, 0.3, 0.9])
    for pose in (SensorPose.from_matrix(turn.as_matrix(), HERE), SensorPose.from_quaternion(turn.as_quat(), HERE)):
        assert pose.position_mm == tuple(HERE)
        np.testing.assert_allclose(pose.axis, turn.as_matrix()[:, 2], atol=1e-12)
        np.testing.assert_allclose(pose.quaternion_xyzw, turn.as_quat(canonical=True), atol=1e-12)


@given(st.lists(any_float, min_size=12, max_size=12))
def test_whatever_the_wire_brings_a_pose_is_finite_or_none_or_refused(values):
    try:
        pose = unpack_transform(struct.pack(">12f", *values))
    except DeviceProtocolError:
        return
    if pose is not None:
        assert np.isfinite([*pose.position_mm, *pose.axis, *pose.quaternion_xyzw]).all()
        assert np.linalg.norm(pose.axis) == pytest.approx(1.0)


def test_a_tool_knows_its_roll_only_with_six_degrees_of_freedom():
    pose = SensorPose.from_quaternion([0, 0, 0, 1], HERE)
    assert Tool("a", 6).sample(NOW, pose, 3).quaternion_xyzw == (0, 0, 0, 1)
    five = Tool("a", 5).sample(NOW, pose, 3, math.nan)
    assert (five.quaternion_xyzw, five.error_mm, five.source_frame) == (None, None, 3)
    assert not Tool("a", 5).sample(NOW, None, 3).visible


@pytest.mark.parametrize(("text", "message"), [("1.2.3", "must be a number"), ("nan", "from 0 to 10"), ("11", "to 10")])
def test_numbers_in_texts_are_refused_with_their_name(text, message):
    with pytest.raises(DeviceProtocolError, match=f"The setting .*{message}"):
        device_number(text, "The setting $30", 0, 10)


def test_a_message_with_other_things_than_numbers_is_refused():
    assert device_numbers([1, math.nan, "x", 1e308, 10**400], "axes") == [1.0, 0.0, 0.0, 0.0, 0.0]
    for wrong in ("abc", None, [0] * 65):
        with pytest.raises(DeviceProtocolError, match="axes must be a list"):
            device_numbers(wrong, "axes")
