"""MCAP: read back by the mcap package with its own decoder."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ursnav_torch.devices import Frame, Joints, Note, RobotSample, Stamp, TrackerSample
from ursnav_torch.errors import InputError
from ursnav_torch.exports import write_mcap
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.kidney import Kidney
from ursnav_torch.session import Event, Result
from ursnav_torch.vid import pose_cells

pytest.importorskip("mcap_protobuf")

WALL = 1_700_000_000.0
POSE = transform_from_quaternion([10.0, -20.0, 30.0], [0.1, -0.2, 0.3, 0.9])


def stamp(n: int, t_s: float, wall_step_s: float = 0.0) -> Stamp:
    return Stamp(n, 50.0 + t_s, WALL + t_s + wall_step_s)


def session() -> list[Event]:
    picture = np.random.default_rng(0).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    row = {k: float(v) for k, v in pose_cells(POSE[None])[0].items()}
    return [
        Frame(stamp(0, 0.0), picture),
        Frame(stamp(1, 0.1), picture, cv2.imencode(".jpg", picture)[1].tobytes(), "jpg"),
        TrackerSample(stamp(0, 0.12), True, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0), 6),
        TrackerSample(stamp(1, 0.13), False),
        TrackerSample(stamp(2, 0.14), True, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0)),  # 5 DoF: no whole pose
        Result(stamp(0, 0.2, wall_step_s=-3600.0), 0, row | {"accepted": True}),
        Result(stamp(1, 0.3), 1, row | {"accepted": False}),
        RobotSample(stamp(0, 0.4), Joints(0.1, -0.2, 25.0), False, "armed"),
        Note(stamp(0, 0.5), "warning", "The lamp is hot."),
    ]


def read(path: Path) -> dict[str, list[tuple[Any, Any, Any]]]:
    """Schema, raw message and decoded message by topic."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: dict[str, list[tuple[Any, Any, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            found.setdefault(channel.topic, []).append((schema.name, message, decoded))
    return found


def test_every_topic_has_foxgloves_schema_and_what_went_in(tmp_path: Path, phantom: Kidney) -> None:
    counts = write_mcap(tmp_path / "s.mcap", session(), phantom.mesh)
    found = read(tmp_path / "s.mcap")
    assert {topic: len(items) for topic, items in found.items()} == counts
    assert {topic: items[0][0] for topic, items in found.items()} == {
        "/camera/image": "foxglove.CompressedImage", "/tf": "foxglove.FrameTransform", "/pose": "foxglove.PoseInFrame",
        "/robot": "foxglove.JointStates", "/log": "foxglove.Log", "/kidney": "foxglove.SceneUpdate",
    }  # fmt: skip
    png, jpeg = (item[2] for item in found["/camera/image"])
    assert (png.format, jpeg.format, png.frame_id) == ("png", "jpeg", "camera")
    original = session()[0].image  # type: ignore[union-attr]
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png.data, np.uint8), cv2.IMREAD_COLOR), original)
    assert found["/log"][0][2].message == "The lamp is hot." and found["/log"][0][2].level == 3
    joints = {j.name: j.position for j in found["/robot"][0][2].joints}
    assert joints == pytest.approx({"bend_x": 0.1, "bend_y": -0.2, "insertion": 0.025})


def test_convention_poses_are_meters_and_of_the_pictures_moment(tmp_path: Path) -> None:
    write_mcap(tmp_path / "s.mcap", session())
    found = read(tmp_path / "s.mcap")
    ((_, raw, pose),) = found["/pose"]
    at, q = pose.pose.position, pose.pose.orientation
    T = transform_from_quaternion([1000 * at.x, 1000 * at.y, 1000 * at.z], [q.x, q.y, q.z, q.w])
    np.testing.assert_allclose(T, POSE, atol=1e-6)
    assert pose.frame_id == "kidney" and pose.timestamp.ToNanoseconds() == pytest.approx(WALL * 1e9, abs=1e4)
    assert raw.log_time == pytest.approx(WALL * 1e9, abs=1e4), "a wall clock set back moves nothing"
    (_, _, camera), (_, _, sensor) = found["/tf"]  # in the order of their moments
    assert (sensor.parent_frame_id, sensor.child_frame_id, sensor.translation.x) == ("em", "sensor", 0.001)
    assert (camera.parent_frame_id, camera.child_frame_id) == ("kidney", "camera")


def test_a_session_that_was_navigated_again_has_its_poses_beside_its_pictures(tmp_path: Path) -> None:
    """Their results are stamped on the day's own clock."""
    events = [replace(e, stamp=stamp(0, 5e5)) if isinstance(e, Result) else e for e in session()]
    write_mcap(tmp_path / "s.mcap", events)
    found = read(tmp_path / "s.mcap")
    taken = found["/camera/image"][0][1].log_time
    camera = [message.log_time for _, message, said in found["/tf"] if said.child_frame_id == "camera"]
    assert [found["/pose"][0][1].log_time, *camera] == [taken, taken]


def test_the_kidney_is_a_surface_in_meters_at_the_beginning(tmp_path: Path, phantom: Kidney) -> None:
    write_mcap(tmp_path / "s.mcap", session(), phantom.mesh)
    ((_, raw, update),) = read(tmp_path / "s.mcap")["/kidney"]
    triangles = update.entities[0].triangles[0]
    assert raw.log_time == pytest.approx(WALL * 1e9, abs=1e4)
    points = np.array([[p.x, p.y, p.z] for p in triangles.points])
    np.testing.assert_allclose(points * 1000, phantom.mesh.vertices)
    np.testing.assert_array_equal(np.reshape(list(triangles.indices), (-1, 3)), phantom.mesh.faces)


def test_a_session_of_nothing_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to be shown"):
        write_mcap(tmp_path / "s.mcap", [TrackerSample(stamp(0, 0.0), False)])
    assert not list(tmp_path.iterdir())
