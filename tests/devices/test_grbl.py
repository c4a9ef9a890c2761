"""The GRBL driver by its byte dialogue, and against the simulated board."""

import random
import time

import numpy as np
import pytest
from clocks import does_not_hang
from dialogue import dialogue, wait_until
from motion import motion_after_sigkill, motion_left_s

from ursnav_torch.devices import GrblRobot, JointRates
from ursnav_torch.devices.robots.reset_watch import ResetWatch, is_mark
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError, InputError
from ursnav_torch.simulation.grbl_board import BANNER, SETTINGS, GrblBoard
from ursnav_torch.simulation.port import SimulatedPort

SETTINGS_TEXT = b"".join(f"${n}={v:g}\r\n".encode() for n, v in SETTINGS.items()) + b"ok\r\n"
IDLE = b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
STATE = b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F1234 S0]\r\nok\r\n"
MARK = [(b"F1234\n", b"ok\r\n"), (b"$G\n", STATE)]
ASK = b"?$G\n"
CONNECT = [(b"\x18", BANNER), (b"$$\n", SETTINGS_TEXT), (b"?", IDLE), *MARK, (ASK, IDLE + STATE)]
FORWARD = JointRates(insertion_mm_s=4.0)
#: 4 mm/s for the horizon of 0.12 s less the ramp of 8 ms.
JOG = b"$J=G21G91Z0.44800F240.00\n$G\n"
JOGS = b"ok\r\n" + STATE


@pytest.fixture(autouse=True)
def asked_rarely(monkeypatch):
    """Dialogues are said word by word: a busy machine must not ask in between where the board stands."""
    monkeypatch.setattr("ursnav_torch.devices.robots.grbl.REPORT_S", 60.0)


@pytest.fixture
def board():
    board = GrblBoard()
    port = SimulatedPort(board, period_s=0.002)
    board.port = port
    yield board
    port.close()


@pytest.fixture
def robot(board):
    with GrblRobot(board.port.path) as robot:
        yield robot


def drive(robot, rates, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        robot.command(rates, True)
        time.sleep(0.02)


def test_connect_drive_stop_and_disconnect_say_exactly_these_bytes():
    with dialogue([*CONNECT, (JOG, JOGS), (b"\x85", b""), (b"\x85", b"")]) as (path, _, _):
        with GrblRobot(path) as robot:
            robot.arm()
            assert robot.command(FORWARD, True).sent.insertion_mm_s == pytest.approx(4.0)
            assert robot.command(JointRates(), True).sent == JointRates()
            assert robot._link.read_available() == b""


def test_bend_goes_out_as_cable_pulls():
    bend = JointRates(bend_x_rad_s=0.3, bend_y_rad_s=-0.2)  # 2 mm from the axis: 0.6 and -0.4 mm/s for 118.6 ms
    jog = b"$J=G21G91X0.07113Y-0.04742F43.26\n$G\n"
    with dialogue([*CONNECT, (jog, JOGS), (b"\x85", b"")]) as (path, _, _), GrblRobot(path) as robot:
        robot.arm()
        sent = robot.command(bend, True).sent
        assert sent.bend_x_rad_s == pytest.approx(0.3, rel=1e-3)
        assert sent.bend_y_rad_s == pytest.approx(-0.2, rel=1e-3)


def test_the_light_waits_until_the_jog_has_ended():
    jogs = IDLE.replace(b"Idle", b"Jog")
    steps = [(b"\x85", b""), (ASK, jogs + STATE), (ASK, IDLE + STATE), (b"M3S300\n", b"ok\r\n")]
    with dialogue([*CONNECT, *steps, (b"\x85", b"")]) as (path, _, _), GrblRobot(path) as robot:
        assert robot.set_light(0.3004) == 0.3


def test_stop_and_acknowledgment_unlock_the_board():
    alarm = b"ALARM:3\r\n" + BANNER + b"[MSG:'$H'|'$X' to unlock]\r\n"
    locked = IDLE.replace(b"Idle", b"Alarm")
    unlock = [(b"\x18", BANNER), (b"?", locked), (b"$X\n", b"[MSG:Caution: Unlocked]\r\nok\r\n"), *MARK]
    unlock += [(ASK, IDLE + STATE)]
    with dialogue([*CONNECT, (JOG, JOGS), (b"\x18", alarm), *unlock, (b"\x85", b"")]) as (path, _, _):
        with GrblRobot(path) as robot:
            robot.arm()
            robot.command(FORWARD, True)
            robot.emergency_stop()
            time.sleep(0.02)
            assert not robot.arm()
            robot.acknowledge()
            assert robot.gate.state == "disarmed"


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (b"error:15\r\n", DeviceProtocolError, "beyond the machine's travel"),
        (b"ALARM:1\r\n", DeviceProtocolError, "hard limit hit"),
        (BANNER, DeviceProtocolError, "was reset in mid-session"),
        (b"rubbish\r\n", DeviceProtocolError, "answered 'rubbish'"),
        (b"\xff\xfe\x80ok\r\n", DeviceProtocolError, "answered"),
        (b"o", DeviceTimeoutError, "so far b'o'"),
        (b"", DeviceTimeoutError, "is it switched on"),
    ],
)
def test_a_fault_in_mid_command_stops_the_motors_within_the_deadline(answer, error, message):
    with dialogue([*CONNECT, (JOG, answer), (b"\x18", b""), (b"\x85", b"")]) as (path, board, _):
        with GrblRobot(path, deadline_s=0.2) as robot:
            robot.arm()
            with does_not_hang(), pytest.raises(error, match=message):
                robot.command(FORWARD, True)
            assert robot.gate.state == "stopped"
            assert wait_until(lambda: board.all_received.endswith(b"\x18"))
            assert robot.command(FORWARD, True).sent.is_zero


@pytest.mark.parametrize("status", [b"<Idle|MPos:0.000,0.0\r\n", b"<Idle|WPos:0.000,0.000,0.000|FS:0,0>\r\n"])
def test_an_unreadable_status_is_refused(status):
    with dialogue([*CONNECT, (ASK, status + STATE), (b"\x18", b""), (b"\x85", b"")]) as (path, _, _):
        with GrblRobot(path) as robot, pytest.raises(DeviceProtocolError, match="unreadable status"):
            robot.read()


def test_unplugging_in_mid_command_is_told_apart_from_silence(board, robot):
    robot.arm()
    robot.command(FORWARD, True)
    board.port.unplug()
    with pytest.raises(DeviceNotConnectedError, match="was it unplugged"):
        for _ in range(3):
            robot.command(FORWARD, True)
            time.sleep(0.03)
    assert robot.gate.state == "stopped"
    robot.stop()
    robot.disconnect()
    robot.stop()


def test_a_board_that_never_answers_fails_within_the_deadline(board):
    board.answering = False
    with does_not_hang(), pytest.raises(DeviceTimeoutError, match="switched on"):
        GrblRobot(board.port.path, boot_s=0.5).connect()


def test_other_firmware_is_refused():
    with dialogue([(b"\x18", b"Grbl 0.9j ['$' for help]\r\n")]) as (path, _, _):
        with pytest.raises(DeviceProtocolError, match=r"GRBL 1\.1 is needed"):
            GrblRobot(path).connect()


def test_no_such_port():
    with pytest.raises(DeviceNotConnectedError, match="dialout"):
        GrblRobot("/dev/no-such-port").connect()
    with pytest.raises(DeviceNotConnectedError, match=r"call connect\(\)"):
        GrblRobot("/dev/no-such-port").read()


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [(122, 10, "Set it to"), (112, 60, r"Raise \$112"), (13, 1, "inches"), (32, 1, "laser mode")],
)
def test_a_board_that_would_move_for_longer_than_told_is_refused(board, setting, value, message):
    board.settings[setting] = value
    with pytest.raises(InputError, match=message):
        GrblRobot(board.port.path).connect()


def test_the_robot_goes_where_it_was_sent(board, robot):
    robot.arm()
    drive(robot, JointRates(0.2, -0.1, 4.0), 0.5)
    robot.stop()
    assert wait_until(lambda: not board.moving, 1.0)
    joints = robot.read().joints
    np.testing.assert_allclose(robot.drive.axes_mm(joints), board.axes_mm(), atol=2e-3)
    assert joints.insertion_mm == pytest.approx(2.0, abs=0.4)


def greeted(greeting, status=IDLE, settings=SETTINGS_TEXT):
    """What a board of another make says while it is connected."""
    return [(b"\x18", greeting), (b"$$\n", settings), (b"?", status), *MARK, (ASK, status + STATE)]


@pytest.mark.parametrize(
    "greeting",
    [
        b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
        b"\xf8\x00\xffGrbl 1.1h ['$' for help]\r\n",
        b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]\r\n",
        b"Grbl 1.2h ['$' for help]\r\n[MSG:Check Limits]\r\n>G54G20:ok\r\n",
    ],
)
def test_boards_that_speak_grbl_under_another_name_are_taken(greeting):
    with dialogue([*greeted(greeting), (b"\x85", b"")]) as (path, _, _), GrblRobot(path) as robot:
        assert robot.gate.state == "disarmed"


@pytest.mark.parametrize(
    "status",
    [
        b"<Idle|MPos:1.000,-2.500,3.250,0.000|Bf:35,1023|FS:0,0|WCO:0.000,0.000,0.000,0.000>\r\n",
        b"<Hold:0|MPos:1.000,-2.500,3.250,0.000,9.000|Bf:15,128|Ln:0|FS:0,0|Pn:XYZ|Ov:100,100,100|A:SFM>\r\n",
        b"<Idle|MPos: 1.000, -2.500, 3.250|FS:0,0>\r\n",
        b"<Idle|MPos:1e0,-25e-1,3.25|FS:0,0>\r\n",
    ],
)
def test_of_more_axes_the_first_three_are_taken(status):
    with dialogue([*greeted(BANNER, status), (b"\x85", b"")]) as (path, _, _), GrblRobot(path) as robot:
        np.testing.assert_array_equal(robot._offset_mm, [1.0, -2.5, 3.25])


def test_settings_that_are_explained_in_brackets_are_read():
    settings = SETTINGS_TEXT.replace(b"$30=1000", b"$30=1000 (max spindle speed, RPM)")
    with dialogue([*greeted(BANNER, settings=settings), (b"\x85", b"")]) as (path, _, _), GrblRobot(path):
        pass


@pytest.mark.parametrize(
    ("setting", "error", "message"),
    [
        (b"$30=0", InputError, r"\$30 must be positive, got 0"),
        (b"$30=1.2.3", DeviceProtocolError, r"\$30 must be a number, got '1.2.3'"),
        (b"$122=nan", DeviceProtocolError, r"\$122 must be a number from 0"),
    ],
)
def test_settings_that_nothing_can_be_computed_from_are_refused(setting, error, message):
    key = setting.split(b"=")[0] + b"="
    lines = [setting if line.startswith(key) else line for line in SETTINGS_TEXT.split(b"\r\n")]
    with dialogue([(b"\x18", BANNER), (b"$$\n", b"\r\n".join(lines))]) as (path, _, _):
        with pytest.raises(error, match=message):
            GrblRobot(path).connect()


def test_a_greeting_of_something_else_is_told():
    with dialogue([(b"\x18", b"Marlin 2.1\r\nstart\r\n")]) as (path, _, _):
        with pytest.raises(DeviceTimeoutError, match=r"it sent \['Marlin 2.1', 'start'\]"):
            GrblRobot(path, boot_s=0.3).connect()


def test_the_end_of_the_slider_is_kept(board):
    from ursnav_torch.devices import Limits

    with GrblRobot(board.port.path, limits=Limits(max_insertion_mm=1.0)) as robot:
        robot.arm()
        drive(robot, JointRates(insertion_mm_s=8.0), 0.6)
        wait_until(lambda: not board.moving, 1.0)
        assert 0.9 < board.axes_mm()[2] < 1.001
        drive(robot, JointRates(insertion_mm_s=-8.0), 0.6)
        wait_until(lambda: not board.moving, 1.0)
        assert -0.001 < board.axes_mm()[2] < 0.1


def test_the_watchdog_stops_and_disarms(board, robot):
    robot.arm()
    robot.command(FORWARD, True)
    assert wait_until(lambda: robot.gate.state == "disarmed")
    assert "watchdog" in robot.gate.reason
    assert not board.moving
    assert robot.command(FORWARD, True).reason.startswith("disarmed: watchdog")


def test_however_jerky_the_driving_less_than_half_a_second_is_queued(board, robot):
    rng = random.Random(1)
    robot.arm()
    longest = 0.0
    for _ in range(8):
        end = time.monotonic() + 0.25
        while time.monotonic() < end:
            rates = JointRates(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.choice([-8.0, 8.0]))
            robot.command(rates, True)
            time.sleep(rng.choice([0.002, 0.02]))
        longest = max(longest, motion_left_s(board))  # nobody commands any more, as if the host were dead
    print(f"longest motion after the last command: {longest:.3f} s")
    assert 0 < longest < 0.5


def test_sigkill_while_driving_ends_the_motion_within_half_a_second(board):
    seconds = motion_after_sigkill("GrblRobot", repr(board.port.path), board)
    print(f"motion after SIGKILL: {seconds:.3f} s")
    assert seconds < 0.5
    stood = board.axes_mm()
    time.sleep(0.6)
    np.testing.assert_array_equal(board.axes_mm(), stood)


@pytest.mark.parametrize(
    ("line", "seen"),
    [
        ("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F1234 S0]", True),
        ("[GC:G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 S0.0 F1234.000]", True),
        ("[GC:G0 G54 G17 G21 G90 G94 G49 G98 G50 M5 M9 T0 F1234. S0.]", True),
        ("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S1234]", False),
        ("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F12340 S0]", False),
        ("ok", None),
        ("[MSG:F1234]", None),
    ],
)
def test_the_mark_is_read_from_the_parsers_state(line, seen):
    assert is_mark(line) is seen


@pytest.mark.parametrize("reset", ["soft", "power"])
def test_convention_a_reset_of_either_kind_wipes_the_feed_rate_and_a_jog_does_not(reset):
    """GRBL's doc/markdown/commands.md: T, S and F "all default to 0 upon a reset"; jogs alter no parser state."""
    board = GrblBoard()
    assert board.handle(b"F1234\n$J=G21G91Z0.1F60.00\n?$G\n").endswith(STATE)
    time.sleep(0.3)
    board.handle(b"\x18") if reset == "soft" else board.power_cycle()
    assert b" F0 " in board.handle(b"$G\n")


def test_a_reset_that_nobody_heard_of_is_seen_by_the_missing_mark(board, robot):
    board.power_cycle()
    assert not robot.read().place_known
    assert robot.gate.state == "stopped" and "lost its mark" in robot.gate.reason
    robot.acknowledge()
    assert not robot.arm()
    robot.confirm_place()
    assert robot.arm() and robot.read().place_known


def test_what_a_reset_board_can_count_is_what_it_was_sent_since_the_mark_was_seen():
    resets = ResetWatch(0.01)
    assert resets.may_count_anew(np.zeros(3)) and not resets.may_count_anew(np.array([0, 0, 0.1]))
    resets.sent(np.array([0, -0.2, 0.5]))
    resets.sent(np.array([0, 0.1, 0.5]))
    assert resets.may_count_anew(np.array([0, -0.2, 1.0])) and resets.may_count_anew(np.array([0, 0.1, 0.3]))
    assert not resets.may_count_anew(np.array([0, 0, 1.1])) and not resets.may_count_anew(np.array([0.1, 0, 0.5]))
    resets.proved()
    assert not resets.may_count_anew(np.array([0, -0.2, 1.0]))


def test_a_board_that_does_not_tell_its_state_is_warned_of_and_used(caplog):
    silent = [(b"F1234\n", b"ok\r\n"), (b"$G\n", b"ok\r\n"), (b"?", IDLE), (b"?", IDLE), (b"\x85", b"")]
    with dialogue([*CONNECT[:3], *silent]) as (path, _, _), GrblRobot(path) as robot:
        assert robot.read().place_known
    assert "a reset may go unseen" in caplog.text
