"""However a driving program ends, its robot is told to stop before the port is closed, and the record is whole."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from dialogue import wait_until

from ursnav_torch.session import Replay
from ursnav_torch.simulation.grbl_board import GrblBoard
from ursnav_torch.simulation.port import SimulatedPort

JOG_CANCEL = b"\x85"
PROGRAM = """
import resource, sys
from functools import partial
from ursnav_torch.devices import Gamepad, GrblRobot, JointRates, OperatorInput
from ursnav_torch.session import Recorder, build_rig
from ursnav_torch.session.open import open_session

class Hands(Gamepad):
    def _open(self): ...
    def _close(self): ...
    def read(self):
        return OperatorInput(self._stamp(), insertion=0.2, dead_man=True, arm=True)

port, how, out = sys.argv[1:]
if how == "left":
    robot = GrblRobot(port)
    robot.connect()
    robot.arm()
    for _ in range(5):
        robot.command(JointRates(insertion_mm_s=2.0), True)
    sys.exit(5)  # with the robot armed, and nobody who disconnects it
if how == "full disk":
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
rig = partial(build_rig, robot=partial(GrblRobot, port), gamepad=Hands())
with open_session(rig, recorder=Recorder(out)) as session:
    print("driving", flush=True)
    print(session.run().text())
"""


class Listening(GrblBoard):
    """A board that keeps what it was told."""

    def __init__(self):
        super().__init__()
        self.told = b""

    def handle(self, data):
        self.told += data
        return super().handle(data)


@pytest.fixture
def board():
    board = Listening()
    port = SimulatedPort(board, period_s=0.002)
    board.path = port.path
    yield board
    port.close()


def program(board: Listening, how: str, out: Path) -> subprocess.Popen[str]:
    call = [sys.executable, "-c", PROGRAM, board.path, how, str(out)]
    return subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_stops_the_robot_and_ends_the_session_in_good_order(board, tmp_path, number):
    process = program(board, "driven", tmp_path / "record")
    assert process.stdout.readline() == "driving\n"
    assert wait_until(lambda: board.told.count(b"$J=") > 5, 60.0)
    process.send_signal(number)
    said, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and "commands" in said, errors
    assert JOG_CANCEL in board.told[board.told.rindex(b"$J=") :] and not board.moving
    assert Replay(tmp_path / "record").damaged == 0


@pytest.mark.slow
def test_a_full_disk_stops_the_robot_and_says_so(board, tmp_path):
    process = program(board, "full disk", tmp_path / "record")
    errors = process.communicate(timeout=120)[1]
    assert process.returncode == 1 and "InputError" in errors and "record" in errors.splitlines()[-1]
    assert JOG_CANCEL in board.told[board.told.rindex(b"$J=") :] and not board.moving


@pytest.mark.slow
def test_an_interpreter_that_exits_with_the_robot_armed_stops_it(board, tmp_path):
    process = program(board, "left", tmp_path / "record")
    assert process.wait(timeout=60) == 5
    process.communicate()
    assert JOG_CANCEL in board.told[board.told.rindex(b"$J=") :]
    assert wait_until(lambda: not board.moving, 1.0)
