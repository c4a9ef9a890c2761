"""What ends the motion when the driving program is frozen or dead: the board's horizon, and a process of its own."""

import ast
import os
import random
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from dialogue import wait_until

from benchmarks.safety import SEEN_S
from benchmarks.safety.bench import KINDS
from benchmarks.safety.frozen import SPEED_MM_S, WAYS, freeze
from ursnav_torch.devices import GrblRobot, JointRates, RosserialRobot
from ursnav_torch.devices.robots.guardian import UNREAD, Guardian
from ursnav_torch.devices.robots.robot import BLIND_S
from ursnav_torch.errors import DeviceError
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.port import SimulatedPort
from ursnav_torch.simulation.rosserial_board import RosserialBoard


@pytest.fixture
def stop():
    """A pipe's ends: what a guardian writes comes out of the first."""
    read_end, write_end = os.pipe()
    os.set_blocking(read_end, False)
    yield read_end, write_end
    os.close(read_end)
    os.close(write_end)


def heard(read_end):
    try:
        return os.read(read_end, 100)
    except BlockingIOError:
        return b""


def test_silence_of_an_armed_program_is_answered_with_the_stop_once(stop):
    guardian = Guardian({stop[1]: b"STOP"}, silence_s=0.3)
    try:
        guardian.feed(True)
        said = []
        assert wait_until(lambda: said.append(heard(stop[0])) or said[-1])
        assert said[-1] == b"STOP"
        time.sleep(0.7)
        assert heard(stop[0]) == b"" and guardian.is_alive
    finally:
        guardian.close()
    assert heard(stop[0]) == b""  # closing in good order stops nothing


def test_a_program_that_is_fed_or_not_armed_is_left_alone(stop):
    guardian = Guardian({stop[1]: b"STOP"}, silence_s=5.0)
    try:
        guardian.feed(True)
        guardian.feed(False)
        time.sleep(0.3)
        assert heard(stop[0]) == b""
    finally:
        guardian.close()
    assert not guardian.is_alive


def test_the_death_of_an_armed_program_is_answered_at_once(stop):
    code = f"""
    import os
    from ursnav_torch.devices.robots.guardian import Guardian
    Guardian({{{stop[1]}: b"STOP"}}, 60.0).feed(True)
    input()
    os._exit(1)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdin=subprocess.PIPE, pass_fds=[stop[1]], text=True
    ) as process:
        process.communicate("\n", timeout=60)
    said = []
    assert wait_until(lambda: said.append(heard(stop[0])) or said[-1]) and said[-1] == b"STOP"


@pytest.fixture(params=["GrblRobot", "RosserialRobot"])
def scene(request):
    """A board, the kind of its robot, and its slider's place in mm."""
    board = GrblBoard() if request.param == "GrblRobot" else RosserialBoard()
    port = SimulatedPort(board, period_s=0.002)
    place = (lambda: board.axes_mm()[2]) if request.param == "GrblRobot" else (lambda: board.steps()[2] / 400)
    ports = repr(port.path) if request.param == "GrblRobot" else repr([port.path])
    yield request.param, ports, board, place
    port.close()


def killed(guardian):
    os.kill(guardian._process.pid, signal.SIGKILL)
    assert wait_until(lambda: not guardian.is_alive)


def test_a_guardian_that_hangs_is_none_until_it_reads_again(stop):
    guardian = Guardian({stop[1]: b"STOP"}, silence_s=60.0)
    try:
        os.kill(guardian._process.pid, signal.SIGSTOP)
        for _ in range(UNREAD):
            assert guardian.is_alive
            guardian.feed(True)
        assert not guardian.is_alive
        os.kill(guardian._process.pid, signal.SIGCONT)
        assert wait_until(lambda: guardian.is_alive)
    finally:
        guardian.close()


def test_an_armed_robot_whose_guardian_dies_is_stopped_and_arming_starts_another(scene):
    kind, ports, board, _ = scene
    forward = JointRates(insertion_mm_s=2.0)
    with (GrblRobot if kind == "GrblRobot" else RosserialRobot)(ast.literal_eval(ports)) as robot:
        robot.arm()
        robot.command(forward, True)
        killed(robot._guardian)
        with pytest.raises(DeviceError, match="second watchdog's process has ended"):
            robot.command(forward, True)
        assert robot.gate.state == "stopped" and "second watchdog" in robot.command(forward, True).reason
        assert wait_until(lambda: not board.moving, 1.0)
        robot.acknowledge()
        robot.confirm_place()
        assert robot.arm() and robot._guardian.is_alive
        assert not robot.command(forward, True).sent.is_zero
        robot.disarm()
        killed(robot._guardian)
        assert robot.command(forward, True).reason.startswith("disarmed")  # nothing moves that had to be watched
        assert robot.arm() and robot._guardian.is_alive


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("how", WAYS)
def test_a_program_frozen_at_8_mm_a_second_moves_no_farther_than_it_may(kind, how):
    seconds, mm = freeze(kind, how, random.Random(f"{kind}/{how}"))
    print(f"{kind} {how}: moved on for {seconds:.3f} s, {mm:.2f} mm")
    assert mm <= SPEED_MM_S * BLIND_S and seconds <= BLIND_S + SEEN_S


@pytest.mark.slow
def test_a_board_that_falls_silent_is_driven_no_farther_than_it_may(scene):
    kind, ports, board, place = scene
    path = ast.literal_eval(ports)
    robot = (GrblRobot if kind == "GrblRobot" else RosserialRobot)(path)
    with robot:
        robot.arm()
        end, at, silent = time.monotonic() + 1.5, 0.0, False
        while time.monotonic() < end and robot.gate.state == "armed":
            if not silent and place() > 2.0:
                silent, at = True, place()
                board.handle, heard_by_motors = _deaf(board), board.handle
            try:
                robot.command(JointRates(insertion_mm_s=8.0), True)
            except Exception as error:
                assert "answer" in str(error) or "hung" in str(error) or "did not send" in str(error)
            time.sleep(0.02)
        assert silent and wait_until(lambda: not board.moving, 1.0)
        print(f"{kind}: {place() - at:.2f} mm after the last report")
        assert place() - at < 1.3
        board.handle = heard_by_motors


def _deaf(board):
    """Hears, and moves as told, but says nothing."""
    hear = board.handle
    return lambda data: hear(data) and b""
