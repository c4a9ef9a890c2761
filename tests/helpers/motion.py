"""How long simulated boards move on when nobody tells them anything any more."""

import subprocess
import sys
import textwrap
import time
from typing import Any

from dialogue import wait_until

DRIVER = """
import sys, time
from ursnav_torch.devices import {kind}, JointRates
robot = {kind}({port})
robot.connect()
robot.arm()
print("driving", flush=True)
while True:
    robot.command(JointRates(0.1, 0.1, 4.0), True)
    time.sleep(0.02)
"""


def motion_left_s(board: Any) -> float:
    """Seconds of motion that a board still has before it, by its own clock: a busy machine adds nothing to them."""
    real, step_s = board._clock, 0.005
    begun = now = real()
    board._clock = lambda: now
    try:
        while board.moving:
            now += step_s
            assert now - begun < 10, "the board never comes to rest"
        return now - begun
    finally:
        board._clock = real


def motion_after_sigkill(kind: str, port: str, board: Any) -> float:
    """Seconds of motion that are left after the driver's process was killed in mid-drive."""
    code = textwrap.dedent(DRIVER).format(kind=kind, port=port)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "driving\n"
        assert wait_until(lambda: board.moving)
        time.sleep(0.3)
        assert wait_until(lambda: board.moving)
        process.kill()
        process.wait()
        time.sleep(0.02)  # what lies in the wire arrives
        return motion_left_s(board)
    finally:
        process.kill()
        process.stdout.close()
        process.wait()
