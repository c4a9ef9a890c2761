"""A driving program that is frozen or dead at full speed: how long, and how far, does the robot move on?"""

import random
import signal
import subprocess
import sys
import time
from typing import Any

from benchmarks.safety.bench import Bench
from ursnav_torch.devices import Limits

WAYS = ("process stopped", "process killed", "interpreter held")
SPEED_MM_S = 8.0
#: The program that is frozen: it drives at full speed, forth and back, and where told to holds the interpreter's lock.
DRIVER = """
import ctypes, sys, time
from ursnav_torch.devices import {kind}, JointRates
robot = {kind}({port})
robot.connect()
robot.arm()
print("driving", flush=True)
begun = time.monotonic()
while True:
    robot.command(JointRates(0.0, 0.0, {speed}), True)
    time.sleep(0.02)
    if time.monotonic() - begun > {hold_s}:
        print("holding", flush=True)
        ctypes.PyDLL(None).usleep(3_000_000)  # a C function that keeps the interpreter's lock: no thread can run
"""


def freeze(kind: str, how: str, draw: random.Random) -> tuple[float, float]:
    """Freeze a program in mid-drive; seconds and mm that its robot moved on, by the board's own clock."""
    with Bench(kind, Limits()) as bench:
        path, name = bench.path, "GrblRobot" if kind == "grbl" else "RosserialRobot"
        bench.robot.disconnect()
        moment_s = draw.uniform(0.3, 1.0)
        code = DRIVER.format(
            kind=name, port=repr(path if kind == "grbl" else [path]), speed=SPEED_MM_S,
            hold_s=moment_s if how == "interpreter held" else 1e9,
        )  # fmt: skip
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None and process.stdout.readline() == "driving\n"
            if how == "interpreter held":
                assert process.stdout.readline() == "holding\n"
            else:
                time.sleep(moment_s)
                process.send_signal(signal.SIGSTOP if how == "process stopped" else signal.SIGKILL)
            return _moves_on(bench)
        finally:
            process.kill()
            process.wait()
            if process.stdout:
                process.stdout.close()


def _moves_on(bench: Bench) -> tuple[float, float]:
    """Seconds and mm from now on until the board rests; its clock is then run ahead, so a busy machine adds nothing."""
    board: Any = bench.board
    begun_s, at_mm = board._clock(), bench.true_mm()
    time.sleep(0.02)  # what lies in the wire arrives
    with board._lock:
        real = board._clock
        now = real()
        board._clock = lambda: now
        try:
            while board.moving and now - begun_s < 10:
                now += 0.002
            return now - begun_s if bench.true_mm() != at_mm else 0.0, bench.true_mm() - at_mm
        finally:
            board._clock = real
