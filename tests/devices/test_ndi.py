"""The NDI driver by its byte dialogue, the simulated unit, and scikit-surgerynditracker as second opinion."""

import math
import os
import struct
import threading
import time
from dataclasses import replace

import pytest
from clocks import Clock, does_not_hang, runs_on
from dialogue import dialogue, wait_until
from fastcrc import crc16
from hypothesis import given
from hypothesis import strategies as st

from ursnav_torch.devices import NdiTracker
from ursnav_torch.devices.trackers.ndi import NdiTool, message, pack_bx, unpack_bx_body
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError, InputError
from ursnav_torch.simulation.ndi_unit import NdiUnit
from ursnav_torch.simulation.port import SimulatedPort

OKAY = b"OKAYA896\r"
SEEN = NdiTool(0x0A, (0.8, 0.0, 0.6, 0.0), (1.5, -2.0, -300.25), 0.125, 7)
HIDDEN = NdiTool(0x0A, None, None, math.nan, 8)
START = [
    (b"INIT:E3A5\r", OKAY),
    (b"COMM:500000048\r", OKAY),
    (b"PHSR:01E03E\r", message("00")),
    (b"PHSR:02E17E\r", message("010A001")),
    (b"PINIT:0AD5EB\r", OKAY),
    (b"PHSR:0321BF\r", message("010A001")),
    (b"PENA:0ADAD1E\r", OKAY),
    (b"TSTART:5423\r", OKAY),
]
BX, STOP = b"BX:080100EC\r", (b"TSTOP:2C14\r", OKAY)


@pytest.mark.parametrize(
    "text", ["INIT:E3A5", "OKAYA896", "VER:065EE", "COMM:500000048", "PHSR:0020FF", "PHSR:04E3FE", "RESETBE6F"]
)
def test_convention_checksums_are_ndis(text):
    assert message(text[:-4]) == text.encode() + b"\r"
    assert crc16.arc(b"123456789") == 0xBB3D


def test_start_read_and_stop_say_exactly_these_bytes():
    with dialogue([*START, (BX, pack_bx([SEEN])), (BX, pack_bx([HIDDEN])), STOP]) as (path, _, _):
        with NdiTracker(path) as tracker:
            sample = tracker.read()
            assert sample.position_mm == (1.5, -2.0, -300.25)
            assert sample.axis == pytest.approx((0.96, 0.0, 0.28))  # the y turn by 2 acos(0.8) takes z there
            assert (sample.dof, sample.quaternion_xyzw) == (5, None)  # roll is not known
            assert (sample.source_frame, sample.error_mm) == (7, 0.125)
            hidden = tracker.read()
            assert (hidden.visible, hidden.position_mm, hidden.axis) == (False, None, None)
            assert tracker._link.read_available() == b""


def test_a_6_dof_tool_keeps_its_quaternion_in_our_order():
    with dialogue([*START, (BX, pack_bx([SEEN])), STOP]) as (path, _, _), NdiTracker(path, dof=6) as tracker:
        assert tracker.read().quaternion_xyzw == pytest.approx((0.0, 0.6, 0.0, 0.8))


def test_a_unit_that_does_not_answer_at_first_is_reset_by_a_break():
    silent = [(b"INIT:E3A5\r", b"")]
    with dialogue([*silent, *START, STOP]) as (path, _, port):

        def reset():  # the break does not get through a pseudo-terminal, so the unit resets by itself
            time.sleep(0.9)
            os.write(port._master, message("RESET"))

        threading.Thread(target=reset).start()
        with NdiTracker(path) as tracker:
            assert tracker.is_connected


def test_tools_left_over_are_freed_first():
    busy = [*START[:2], (START[2][0], message("010B011")), (message("PHF:0B"), OKAY), *START[3:]]
    with dialogue([*busy, STOP]) as (path, _, _), NdiTracker(path):
        pass


BAD_BODY = pack_bx([SEEN])[:-2] + b"\0\0"
BAD_HEAD = pack_bx([SEEN])[:4] + b"\0\0"


@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        (BAD_BODY, DeviceProtocolError, "wrong CRC of a BX answer"),
        (BAD_HEAD, DeviceProtocolError, "wrong CRC of a BX header"),
        (message("RESET"), DeviceProtocolError, "was reset in mid-session"),
        (message("ERROR0C"), DeviceProtocolError, "invalid in the current mode"),
        (b"OKAY0000\r", DeviceProtocolError, "wrong CRC of the answer"),
        (pack_bx([]), DeviceProtocolError, "handle 0A is gone"),
        (pack_bx([SEEN])[:20], DeviceTimeoutError, "did not send"),
        (b"", DeviceTimeoutError, "did not send"),
    ],
)
def test_faults_of_a_reading_raise_the_right_error_within_the_deadline(answer, error, text):
    with dialogue([*START, (BX, answer), STOP]) as (path, _, _), NdiTracker(path) as tracker:
        with does_not_hang(), pytest.raises(error, match=text):
            tracker.read(timeout_s=0.3)


@pytest.mark.parametrize("delay_s", [0.0, 0.3])
@pytest.mark.parametrize("in_time", [0, 20])
def test_an_answer_that_comes_too_late_is_not_taken_for_the_next(delay_s, in_time):
    late = pack_bx([SEEN])
    now = replace(SEEN, position_mm=(9.0, 9.0, 9.0), frame=90)
    asked = [(BX, late[:in_time]), (BX, pack_bx([now])), (BX, pack_bx([HIDDEN]))]
    with dialogue([*START, *asked, STOP]) as (path, _, port), NdiTracker(path) as tracker:
        with pytest.raises(DeviceTimeoutError):
            tracker.read(timeout_s=0.1)
        rest = threading.Timer(delay_s, lambda: os.write(port._master, late[in_time:]))
        rest.start()
        time.sleep(0.0 if delay_s else 0.1)
        assert [tracker.read(timeout_s=20.0).source_frame for _ in range(2)] == [90, 8]
        rest.join()


def test_an_answer_that_is_owed_is_waited_for_before_the_next_is_asked_for_and_not_for_ever(monkeypatch):
    with dialogue([*START, (BX, b""), (BX, pack_bx([SEEN])), STOP]) as (path, board, _):
        with NdiTracker(path) as tracker:
            clock = Clock()
            runs_on(clock, "ursnav_torch.devices.trackers.ndi", monkeypatch)
            for _ in range(2):
                with pytest.raises(DeviceTimeoutError, match="did not send"):
                    tracker.read(timeout_s=0.5)
                assert wait_until(lambda: len(board.steps) == 2)
            clock.now_s += tracker.deadline_s
            assert tracker.read(timeout_s=20.0).source_frame == 7


def test_no_tool_plugged_in_is_refused():
    none = [*START[:3], (START[3][0], message("00")), (START[5][0], message("00"))]
    with dialogue([*none, STOP]) as (path, _, _), pytest.raises(DeviceProtocolError, match="Plug the sensor in"):
        NdiTracker(path).connect()


def test_a_tool_without_srom_is_explained():
    failing = [*START[:4], (START[4][0], message("ERROR13"))]
    with dialogue([*failing, STOP]) as (path, _, _), pytest.raises(DeviceProtocolError, match="SROM"):
        NdiTracker(path).connect()


def test_refusals():
    with pytest.raises(InputError, match="5 or 6"):
        NdiTracker("/dev/null", dof=4)
    with pytest.raises(DeviceProtocolError, match="cut short"):
        unpack_bx_body(b"\x01\x0a\x01")
    with pytest.raises(DeviceProtocolError, match="asks for"):
        unpack_bx_body(b"\x00\x00\x00\x00")


floats = st.floats(-1000, 1000, width=32)


numbers = st.integers(0, 2**32 - 1)
poses = st.builds(NdiTool, st.integers(0, 255), st.tuples(*[floats] * 4), st.tuples(*[floats] * 3), floats, numbers)


@given(st.lists(poses, max_size=4))
def test_poses_round_trip(tools):
    raw = pack_bx(tools)
    length, head_crc = struct.unpack("<HH", raw[2:6])
    assert head_crc == crc16.arc(raw[:4])
    assert len(raw) == 6 + length + 2
    assert unpack_bx_body(raw[6:-2]) == tools


@pytest.fixture
def unit():
    unit = NdiUnit(lambda: ((10.0, 20.0, -300.5), (0.0, 0.0, 0.6, 0.8)))
    unit.port = SimulatedPort(unit, period_s=0.002)
    yield unit
    unit.port.close()


def test_the_simulated_unit_gives_every_frame_once_at_its_rate():
    """The unit's clock goes on only when a sample has been taken, and by one frame: none may be missed or repeated."""
    taken = [0]
    unit = NdiUnit(lambda: ((10.0, 20.0, -300.5), (0.0, 0.0, 0.6, 0.8)), rate_hz=40.0, clock=lambda: taken[0] / 40.0)
    port = SimulatedPort(unit, period_s=0.002)
    frames = []
    with NdiTracker(port.path) as tracker:
        for _ in range(20):
            frames.append(tracker.read().source_frame)
            with pytest.raises(DeviceTimeoutError):
                tracker.read(timeout_s=0.01)  # the same frame again is not a sample
            taken[0] += 1
    port.close()
    assert frames == list(range(20))


def test_a_unit_that_dies_in_mid_session(unit):
    with NdiTracker(unit.port.path) as tracker:
        tracker.read()
        unit.answering = False
        with pytest.raises(DeviceTimeoutError):
            tracker.read(timeout_s=0.2)
        unit.port.unplug()
        with pytest.raises(DeviceNotConnectedError, match="unplugged"):
            tracker.read(timeout_s=0.2)
    with pytest.raises(DeviceNotConnectedError, match=r"connect\(\)"):
        tracker.read()
