"""OpenIGTLink: golden checks, pyigtl as second opinion, and the tracker over a real socket."""

import contextlib
import json
import socket
import threading
import time

import numpy as np
import pytest
from clocks import does_not_hang
from dialogue import wait_until
from fastcrc import crc64
from scipy.spatial.transform import Rotation

from ursnav_torch.devices import Frame, OpenIgtlServer, OpenIgtlTracker, SlicerOutput, Stamp
from ursnav_torch.devices.igtl.messages import (
    HEADER,
    TOOL_5D,
    TOOL_6D,
    Header,
    Message,
    pack_message,
    pack_tracking_data,
    pack_transform,
    unpack_position,
    unpack_tracking_data,
    unpack_transform,
)
from ursnav_torch.devices.igtl.server import _messages
from ursnav_torch.devices.igtl.shown import pack_image, pack_string, pixels_before_camera
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError, InputError
from ursnav_torch.geometry import transform_from
from ursnav_torch.simulation.igtl_tracker import SimulatedIgtlTracker

R = Rotation.from_quat([0.1, -0.2, 0.3, 0.9]).as_matrix()
T = transform_from(R, [1.5, -20.0, 300.0])


CONTENT = pack_transform(T)


def assert_pose(pose):
    assert pose.position_mm == pytest.approx(T[:3, 3].tolist(), abs=1e-4)
    np.testing.assert_allclose(Rotation.from_quat(pose.quaternion_xyzw).as_matrix(), R, atol=1e-6)


def raw(kind="TRANSFORM", device="Scope", content=CONTENT):
    return pack_message(Message(kind, device, content, 1234.5))


@contextlib.contextmanager
def server(*chunks, hold_s=1.0):
    """A server on a real socket that sends these bytes to the first client and then falls silent."""
    listener = socket.create_server(("127.0.0.1", 0))
    received = []

    def run():
        client, _ = listener.accept()
        with client:
            for chunk in chunks:
                client.sendall(chunk)
                time.sleep(0.01)
            client.settimeout(hold_s)
            with contextlib.suppress(TimeoutError):
                while data := client.recv(1000):
                    received.append(data)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield listener.getsockname()[1], received
    finally:
        thread.join()
        listener.close()


def test_convention_checksum_header_and_order_are_the_protocols():
    assert crc64.ecma_182(b"123456789") == 0x6C40DF5F0B497347
    assert HEADER.size == 58
    assert raw()[:2] == b"\0\1" and raw()[2:11] == b"TRANSFORM" and raw()[14:19] == b"Scope"
    columns = np.frombuffer(pack_transform(T), ">f4")
    np.testing.assert_allclose(columns, [*R[:, 0], *R[:, 1], *R[:, 2], 1.5, -20, 300], rtol=1e-6)
    half_second = int.from_bytes(raw()[38:42], "big")
    assert half_second == 2**31


def test_messages_round_trip():
    message = Header.unpack(raw()[:58]).message(raw()[58:])
    assert (message.kind, message.device, message.t_s) == ("TRANSFORM", "Scope", 1234.5)
    assert_pose(unpack_transform(message.content))
    tools = [("Scope", TOOL_5D, T), ("Probe", TOOL_6D, np.eye(4))]
    back = unpack_tracking_data("TDATA", pack_tracking_data(tools))
    assert [(t.name, t.kind) for t in back] == [("Scope", TOOL_5D), ("Probe", TOOL_6D)]
    assert_pose(back[0].pose)


def test_both_implementations_say_the_same_bytes():
    pyigtl = pytest.importorskip("pyigtl", reason="the second opinion is not installed")
    theirs = pyigtl.TransformMessage(T, timestamp=1234.5, device_name="Scope").pack()
    assert theirs == raw()


def test_a_position_is_a_point_and_a_quaternion_x_y_z_w():
    values = np.array([1.5, -20.0, 300.0, 0.0, 0.6, 0.0, 0.8], ">f4")
    pose = unpack_position(values.tobytes())
    assert pose.position_mm == (1.5, -20, 300)
    assert pose.axis == pytest.approx((0.96, 0.0, 0.28), abs=1e-6)


def test_a_version_2_message_of_pyigtl_is_understood_with_its_metadata():
    pyigtl = pytest.importorskip("pyigtl", reason="the second opinion is not installed")
    message = pyigtl.TransformMessage(T, device_name="Scope")
    message.header_version, message.metadata = 2, {"ScopeTransformStatus": "MISSING"}
    bytes_ = message.pack()
    back = Header.unpack(bytes_[:58]).message(bytes_[58:])
    assert back.metadata == {"ScopeTransformStatus": "MISSING"}
    assert_pose(unpack_transform(back.content))
    with server(bytes_) as (port, _), OpenIgtlTracker("Scope", port=port) as tracker:
        assert not tracker.read().visible


def test_only_our_tool_is_read_whatever_else_comes_and_however_it_is_cut():
    stream = raw("STRING", "x", b"\0\3\0\2hi") + raw("NOBODYKNOWS", "y", bytes(100)) + raw(device="Other") + raw()
    chunks = [stream[at : at + 37] for at in range(0, len(stream), 37)]
    with server(*chunks) as (port, _), OpenIgtlTracker("Scope", port=port, dof=6) as tracker:
        sample = tracker.read()
        assert sample.position_mm == pytest.approx((1.5, -20, 300))
        np.testing.assert_allclose(sample.axis, R[:, 2], atol=1e-6)
        np.testing.assert_allclose(Rotation.from_quat(sample.quaternion_xyzw).as_matrix(), R, atol=1e-6)


def test_a_5_dof_tool_has_no_roll_and_one_that_is_left_out_is_not_visible():
    seen = raw("TDATA", "Tracker", pack_tracking_data([("Scope", TOOL_5D, T)]))
    with server(seen, raw("TDATA", "Tracker", b"")) as (port, _), OpenIgtlTracker("Scope", port=port, dof=6) as tracker:
        sample, hidden = tracker.read(), tracker.read()
    assert (sample.visible, sample.dof, sample.quaternion_xyzw) == (True, 5, None)
    assert (hidden.visible, hidden.position_mm) == (False, None)


@pytest.mark.parametrize(
    ("stream", "error", "text"),
    [
        (raw()[:-1] + b"\x99", DeviceProtocolError, "wrong checksum of a TRANSFORM"),
        (b"HTTP/1.1 400 Bad Request" + bytes(60), DeviceProtocolError, "is an OpenIGTLink server on that port"),
        (raw(content=b"short"), DeviceProtocolError, "has 48 bytes"),
        (raw("TDATA", "Tracker", bytes(69)), DeviceProtocolError, "no multiple of 70"),
        (raw()[:80], DeviceTimeoutError, "nothing was heard"),
        (raw(device="ScopeToReference"), DeviceTimeoutError, r"heard of \['ScopeToReference'\]"),
        (b"", DeviceTimeoutError, "nothing was heard"),
    ],
)
def test_faults_raise_the_right_error_within_the_deadline(stream, error, text):
    with server(stream) as (port, _), OpenIgtlTracker("Scope", port=port) as tracker:
        with does_not_hang(), pytest.raises(error, match=text):
            tracker.read(timeout_s=0.3)


def test_a_message_cut_by_a_deadline_is_read_to_its_end_by_the_next_call():
    listener = socket.create_server(("127.0.0.1", 0))
    with listener, OpenIgtlTracker("Scope", port=listener.getsockname()[1]) as tracker:
        client, _ = listener.accept()
        with client:
            client.sendall(raw()[:80])
            with pytest.raises(DeviceTimeoutError):
                tracker.read(timeout_s=0.1)
            client.sendall(raw()[80:])
            assert tracker.read(timeout_s=0.5).visible


def test_a_server_that_goes_away_is_noticed_at_once():
    with server(hold_s=0.05) as (port, _), OpenIgtlTracker("Scope", port=port) as tracker:
        with does_not_hang(), pytest.raises(DeviceNotConnectedError, match="closed the connection"):
            tracker.read(timeout_s=1e4)


def test_refusals():
    with pytest.raises(DeviceNotConnectedError, match="start PLUS or Slicer"):
        OpenIgtlTracker("Scope", port=1).connect()
    with pytest.raises(InputError, match="5 or 6"):
        OpenIgtlTracker("Scope", dof=3)
    with OpenIgtlServer(port=0) as taken, pytest.raises(DeviceNotConnectedError, match="choose another port"):
        OpenIgtlServer(port=taken.port)


@pytest.mark.parametrize("subscribe_ms", [0, 25])
def test_the_simulated_server_streams_at_its_rate(subscribe_ms):
    simulated = SimulatedIgtlTracker(lambda: ((1.0, 2.0, -300.5), (0.0, 0.0, 0.6, 0.8)))
    try:
        with OpenIgtlTracker(simulated.device, port=simulated.port, subscribe_ms=subscribe_ms) as tracker:
            samples = [tracker.read() for _ in range(20)]
        assert samples[-1].position_mm == (1.0, 2.0, -300.5)
        assert samples[-1].stamp.t_mono_s - samples[0].stamp.t_mono_s == pytest.approx(19 / 40, abs=0.06)
    finally:
        simulated.close()


def test_the_localized_pose_reaches_slicers_client():
    pyigtl = pytest.importorskip("pyigtl", reason="the second opinion is not installed")
    with SlicerOutput(port=0) as output:
        client = pyigtl.OpenIGTLinkClient(port=output.port)
        try:
            assert wait_until(lambda: output.publish_pose(T, 1234.5) or client.incoming_messages)
            message = client.wait_for_message("CameraToKidney", timeout=1.0)
            np.testing.assert_allclose(message.matrix, np.diag([-1, -1, 1, 1]) @ T, atol=1e-4)
            assert message.timestamp == 1234.5
        finally:
            client.stop()


def test_a_kidney_in_ras_is_where_slicers_world_has_it():
    with SlicerOutput(port=0, kidney_frame="ras") as output, stream(output) as messages:
        assert wait_until(lambda: output.publish_pose(T, 1.0) or messages)
        np.testing.assert_allclose(unpack_transform(messages[0].content).position_mm, T[:3, 3], atol=1e-4)
    with pytest.raises(InputError, match="accepted are lps and ras"):
        SlicerOutput(kidney_frame="xyz")


@contextlib.contextmanager
def stream(output):
    """Messages that a client of an output gets, read by our own reader of bytes, as they come."""
    messages, end = [], threading.Event()

    def run():
        pending = bytearray()
        with socket.create_connection(("127.0.0.1", output.port)) as client:
            client.settimeout(0.02)
            while not end.is_set():
                with contextlib.suppress(TimeoutError):
                    pending += client.recv(1 << 16)
                    messages.extend(_messages(pending))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield messages
    finally:
        end.set()
        thread.join()


@pytest.mark.parametrize("shape", [(30, 41), (31, 40, 3)])
def test_pictures_reach_slicers_client_pixel_by_pixel_at_their_place(shape):
    pyigtl = pytest.importorskip("pyigtl", reason="the second opinion is not installed")
    picture = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    with SlicerOutput(port=0, picture_mm=8.0) as output:
        client = pyigtl.OpenIGTLinkClient(port=output.port)
        try:
            frame = Frame(Stamp(0, 1.0, 1234.5), picture)
            assert wait_until(lambda: output.publish_image(frame) or client.incoming_messages)
            message = client.wait_for_message("ScopePicture", timeout=5.0)
        finally:
            client.stop()
    sent = picture if picture.ndim == 2 else picture[..., ::-1]  # red, green, blue
    np.testing.assert_array_equal(np.squeeze(message.image), sent)
    height, width = shape[:2]
    middle = message.ijk_to_world_matrix @ [(width - 1) / 2, (height - 1) / 2, 0, 1]
    np.testing.assert_allclose(middle[:3], [0, 0, 8.0], atol=1e-5)
    np.testing.assert_allclose(message.ijk_to_world_matrix[:3, :2] * width / 8.0, np.eye(3)[:, :2], atol=1e-5)


def test_coverage_reaches_slicers_client_as_text_even_one_that_comes_later():
    pyigtl = pytest.importorskip("pyigtl", reason="the second opinion is not installed")
    with SlicerOutput(port=0) as output:
        output.publish_coverage({"Ä": ("inspected", 0.91)}, 1.0)
        client = pyigtl.OpenIGTLinkClient(port=output.port)
        try:
            assert json.loads(client.wait_for_message("Coverage", timeout=5.0).string) == {"Ä": ["inspected", 0.91]}
        finally:
            client.stop()


def test_pictures_larger_than_any_buffer_arrive_whole_with_poses_between_them():
    picture = np.random.default_rng(0).integers(0, 255, (1080, 1920, 3), dtype=np.uint8)
    with SlicerOutput(port=0) as output, stream(output) as messages, does_not_hang(60.0):
        while sum(m.kind == "IMAGE" for m in messages) < 3 or sum(m.kind == "TRANSFORM" for m in messages) < 20:
            output.publish_image(Frame(Stamp(0, 1.0, 2.0), picture))
            output.publish_pose(T, 2.0)
            time.sleep(0.01)
    contents = {m.content for m in messages if m.kind == "IMAGE"}
    assert contents == {pack_image(picture, pixels_before_camera(1920, 1080, 10.0))}


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((3, 4), np.float32),
        np.zeros((3, 4, 2), np.uint8),
        np.zeros((1, 70_000), np.uint8),
        np.zeros((0, 4), np.uint8),
    ],
)
def test_what_is_no_picture_is_refused(picture):
    with pytest.raises(InputError, match=r"A picture is uint8 \(H, W\) or \(H, W, 3\), got"):
        pack_image(picture, np.eye(4))


def test_a_text_too_long_for_its_message_is_refused():
    with pytest.raises(InputError, match="does not fit into a STRING"):
        pack_string("ä" * 40_000)


def test_clients_that_leave_or_do_not_read_hold_nobody_up():
    with OpenIgtlServer(port=0) as sender:
        with socket.create_connection(("127.0.0.1", sender.port)):
            assert wait_until(lambda: sender.send_pose(T) == 1)
        assert wait_until(lambda: sender.send_pose(T) == 0)
        with socket.create_connection(("127.0.0.1", sender.port)):
            assert wait_until(lambda: sender.send_pose(T) == 1)
            with does_not_hang(60.0):
                assert any(sender.send_pose(T) == 0 for _ in range(200_000))  # its buffers are full: dropped


def test_a_tool_that_is_not_seen_for_a_moment_costs_one_sample():
    hidden = raw(content=bytes(48))
    with server(raw(), hidden, raw()) as (port, _), OpenIgtlTracker("Scope", port=port) as tracker:
        assert [tracker.read().visible for _ in range(3)] == [True, False, True]


def test_names_that_are_heard_are_remembered_within_bounds():
    others = b"".join(raw(device=f"tool {n}") for n in range(200))
    with server(others) as (port, _), OpenIgtlTracker("Scope", port=port) as tracker:
        with pytest.raises(DeviceTimeoutError, match="heard of"):
            tracker.read(timeout_s=0.5)
        assert len(tracker._heard) <= 30
