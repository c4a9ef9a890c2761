"""The rosserial protocol and its robot: golden bytes, dialogue, faults, and the simulated Arduino."""

import hashlib
import time

import numpy as np
import pytest
from clocks import does_not_hang
from dialogue import dialogue, wait_until
from hypothesis import given
from hypothesis import strategies as st
from motion import motion_after_sigkill

from ursnav_torch.devices import JointRates, RosserialLight, RosserialRobot
from ursnav_torch.devices.robots.rosserial import BEND, BEND_POSITION, LIGHT, SLIDER, SLIDER_POSITION
from ursnav_torch.devices.robots.rosserial_packets import (
    INT32S,
    REQUEST_TOPICS,
    STOP_SENDING,
    UINT8,
    Decoder,
    Packet,
    RosserialLink,
    TopicInfo,
    pack_ints,
    pack_packet,
    unpack_ints,
)
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError, InputError
from ursnav_torch.simulation.port import SimulatedPort
from ursnav_torch.simulation.rosserial_board import RosserialBoard

FORWARD = JointRates(insertion_mm_s=4.0)
ANNOUNCED = b"".join(
    pack_packet(Packet(kind, TopicInfo(number, name, *message).pack()))
    for kind, number, name, message in [
        (0, 100, BEND_POSITION, INT32S),
        (0, 101, SLIDER_POSITION, INT32S),
        (1, 102, BEND, INT32S),
        (1, 103, SLIDER, INT32S),
        (1, 104, LIGHT, UINT8),
    ]
)
STANDING = pack_packet(Packet(100, pack_ints([0, 0, 0]))) + pack_packet(Packet(101, pack_ints([0, 0])))
CONNECT = (REQUEST_TOPICS, ANNOUNCED + STANDING)
#: 4 mm/s at 400 steps a mm for 120 ms.
DRIVE = pack_packet(Packet(102, pack_ints([0, 0, 120]))) + pack_packet(Packet(103, pack_ints([192, 120])))
HALT = pack_packet(Packet(102, pack_ints([0, 0, 0]))) + pack_packet(Packet(103, pack_ints([0, 0])))


@pytest.fixture
def board():
    board = RosserialBoard()
    board.port = SimulatedPort(board, period_s=0.002)
    yield board
    board.port.close()


@pytest.fixture
def robot(board):
    with RosserialRobot([board.port.path]) as robot:
        yield robot


def test_convention_bytes_are_those_of_the_protocol():
    assert pack_packet(Packet(125, b"\x34\x12")).hex(" ") == "ff fe 02 00 fd 7d 00 34 12 3c"
    assert REQUEST_TOPICS.hex(" ") == "ff fe 00 00 ff 00 00 ff"
    assert STOP_SENDING.hex(" ") == "ff fe 00 00 ff 0b 00 f4"


def test_convention_md5_sums_are_those_of_the_message_definitions():
    def md5(text):
        return hashlib.md5(text.encode()).hexdigest()

    dimension = md5("string label\nuint32 size\nuint32 stride")
    layout = md5(f"{dimension} dim\nuint32 data_offset")
    assert INT32S[1] == md5(f"{layout} layout\nint32[] data")
    assert UINT8[1] == md5("uint8 data")


@given(st.lists(st.tuples(st.integers(0, 65535), st.binary(max_size=40)), max_size=5), st.integers(1, 7))
def test_packets_survive_the_stream_in_pieces_of_any_size(items, piece):
    stream = b"boot\r\n" + b"".join(pack_packet(Packet(*item)) for item in items)
    decoder, found = Decoder(), []
    for at in range(0, len(stream), piece):
        found += decoder.feed(stream[at : at + piece])
    assert found == [Packet(*item) for item in items]


@given(st.integers(0, 9), st.integers(1, 255))
def test_every_changed_byte_is_noticed(at, change):
    raw = bytearray(pack_packet(Packet(125, b"\x34\x12")))
    raw[at] ^= change
    decoder = Decoder()
    try:
        assert Packet(125, b"\x34\x12") not in decoder.feed(bytes(raw))
    except DeviceProtocolError as error:
        assert "wrong checksum" in str(error)


def test_decoding_goes_on_after_a_broken_packet():
    decoder = Decoder()
    broken = pack_packet(Packet(125, b"\x34\x12"))[:-1] + b"\x00"
    with pytest.raises(DeviceProtocolError, match="wrong checksum"):
        decoder.feed(broken + pack_packet(Packet(126, b"")))
    assert decoder.feed(b"") == [Packet(126, b"")]


@given(st.lists(st.integers(-(2**31), 2**31 - 1)))
def test_numbers_round_trip(values):
    assert unpack_ints(pack_ints(values)) == values


def test_connect_drive_stop_and_disconnect_say_exactly_these_bytes():
    end = (HALT + STOP_SENDING, b"")
    with dialogue([CONNECT, (DRIVE, STANDING), (HALT, b""), end]) as (path, _, _), RosserialRobot([path]) as robot:
        robot.arm()
        robot._heard_s = [time.monotonic() + 60] * 2  # a report that stays fresh
        assert robot.command(FORWARD, True).sent == FORWARD
        assert robot.command(JointRates(), True).sent.is_zero


def test_the_board_gets_the_time_it_asks_for():
    asks = pack_packet(Packet(10, bytes(8)))
    link_needs = {LIGHT: UINT8}
    with dialogue([(REQUEST_TOPICS, asks + ANNOUNCED)]) as (path, board, _):
        board.steps.append((b"\xff\xfe\x08\x00\xf7\x0a\x00", b""))
        link = RosserialLink(path, 57600, link_needs, 1.0)
        assert wait_until(lambda: not board.steps)
        stamp = bytes(board.received)
        assert abs(int.from_bytes(stamp[:4], "little") - time.time()) < 2
        board.received.clear()
        board.surprise = b""
        board.steps.append((STOP_SENDING, b""))
        link.close()


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (STANDING[:-1] + b"\x00", DeviceProtocolError, "wrong checksum"),
        (pack_packet(Packet(100, b"\x01\x02")), DeviceProtocolError, "not an Int32MultiArray"),
        (b"booting" + ANNOUNCED, DeviceProtocolError, "was reset in mid-session"),
        (STANDING[:9], DeviceTimeoutError, "is the board hung"),
        (b"", DeviceTimeoutError, "is the board hung"),
    ],
)
def test_a_fault_in_mid_drive_stops_the_motors_within_the_deadline(answer, error, message):
    with dialogue([CONNECT, (DRIVE, answer)]) as (path, board, _):
        robot = RosserialRobot([path])
        robot.connect()
        robot.arm()
        robot._heard_s = [time.monotonic() + 60] * 2
        robot.command(FORWARD, True)
        robot._heard_s = [time.monotonic()] * 2
        board.again = HALT if error is DeviceTimeoutError else b""  # silence lasts, and the watchdog halts again
        board.steps += [(HALT, b""), (HALT + STOP_SENDING, b"")]
        with does_not_hang(), pytest.raises(error, match=message):
            while True:
                robot.read()
                time.sleep(0.01)
        assert robot.gate.state == "stopped"
        assert wait_until(lambda: HALT in board.all_received)
        robot.disconnect()


def test_a_board_without_the_topics_is_refused_with_their_names(monkeypatch):
    monkeypatch.setattr("ursnav_torch.devices.robots.rosserial.ANNOUNCE_S", 0.3)
    other = pack_packet(Packet(0, TopicInfo(100, "/chatter", "std_msgs/String", "x" * 32).pack()))
    with dialogue([(REQUEST_TOPICS, other)]) as (path, _, _):
        with pytest.raises(DeviceTimeoutError, match=r"bend_position.*announced \['/chatter'\]"):
            RosserialRobot([path]).connect()


def test_a_topic_of_another_type_is_refused():
    other = pack_packet(Packet(1, TopicInfo(100, LIGHT, "std_msgs/Float32", "y" * 32).pack()))
    with dialogue([(REQUEST_TOPICS, other)]) as (path, _, _):
        with pytest.raises(DeviceProtocolError, match="expected std_msgs/UInt8"):
            RosserialLight(path).connect()


def test_a_board_that_never_answers_fails_within_the_deadline(board, monkeypatch):
    monkeypatch.setattr("ursnav_torch.devices.robots.rosserial.ANNOUNCE_S", 0.5)
    board.answering = False
    with does_not_hang(), pytest.raises(DeviceTimeoutError, match="right sketch"):
        RosserialRobot([board.port.path]).connect()


def test_unplugging_is_told_apart_from_silence(board, robot):
    robot.arm()
    robot.command(FORWARD, True)
    board.port.unplug()
    with pytest.raises(DeviceNotConnectedError, match="was it unplugged"):
        robot.command(FORWARD, True)
    assert robot.gate.state == "stopped"


def test_the_robot_goes_where_it_was_sent_and_two_boards_do_as_well_as_one(board):
    other = RosserialBoard()
    port = SimulatedPort(other, period_s=0.002)
    try:
        with RosserialRobot([board.port.path, port.path]) as robot:
            robot.arm()
            end = time.monotonic() + 0.4
            while time.monotonic() < end:
                robot.command(JointRates(0.2, 0.0, 4.0), True)
                time.sleep(0.02)
            robot.stop()
            time.sleep(0.3)
            steps = np.rint([*board.steps()[:2], other.steps()[2]])
            np.testing.assert_allclose(robot.drive.steps(robot.read().joints), steps, atol=1)
            assert steps[0] > 60 and steps[2] > 400
            assert board.steps()[2] == 0 and (other.steps()[:2] == 0).all()
    finally:
        port.close()
    with pytest.raises(InputError, match="one or two"):
        RosserialRobot([])


def test_stop_needs_acknowledgment_and_a_restarted_board_is_taken_up_again(board, robot):
    robot.arm()
    robot.command(FORWARD, True)
    robot.emergency_stop("operator")
    assert wait_until(lambda: not board.moving, 1.0)
    assert robot.command(FORWARD, True).sent.is_zero
    assert not robot.arm()
    robot.acknowledge()
    assert robot.arm()
    assert not robot.command(FORWARD, True).sent.is_zero


def test_the_light_of_an_arduino_of_its_own(board):
    with RosserialLight(board.port.path) as light:
        assert light.set_level(0.5).level == 128 / 255
        assert light.set_level(7.0).level == 1.0
        assert wait_until(lambda: board.light == 1.0)


def test_sigkill_while_driving_ends_the_motion_within_half_a_second(board):
    seconds = motion_after_sigkill("RosserialRobot", repr([board.port.path]), board)
    print(f"motion after SIGKILL: {seconds:.3f} s")
    assert seconds < 0.5
