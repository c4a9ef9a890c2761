"""Faults on a clock: what labs see in a day, every few seconds, and an operator who takes note of each stop."""

import os
import random
import threading
import time
from array import array
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ursnav_torch.devices import Gamepad, OperatorInput, Robot
from ursnav_torch.devices.robots.safety import DISARMED, STOPPED
from ursnav_torch.session import Rig
from ursnav_torch.simulation import SimulatedGrblRobot, SimulatedOpenIgtlTracker, TwinCamera


class Operator(Gamepad):
    """The pilot's hands, and a thumb that acknowledges stops, confirms a lost place and arms again."""

    def __init__(self, pilot: Gamepad, robot: Robot) -> None:
        super().__init__()
        self._pilot, self._robot, self._pressed_s = pilot, robot, 0.0
        self.acknowledged = self.confirmed = 0

    def read(self) -> OperatorInput:
        """The pilot's input, with a press every second and a half while the robot is not armed."""
        hands = self._pilot.read()
        if self._robot.gate.state not in (STOPPED, DISARMED) or time.monotonic() - self._pressed_s < 1.5:
            return replace(hands, arm=False)
        self._pressed_s = time.monotonic()
        if self._robot.gate.state == STOPPED:
            self.acknowledged += 1
            return replace(hands, acknowledge=True)
        if not self._robot.place.is_known:
            self.confirmed += 1
            return replace(hands, acknowledge=True)
        return replace(hands, arm=True)

    def _open(self) -> None:
        self._pilot.connect()

    def _close(self) -> None:
        self._pilot.disconnect()


class Faults:
    """Plants a fault every ``every_s`` seconds in a running rig; a context manager.

    Args:
        rig: simulated camera, OpenIGTLink tracker and GRBL robot.
        every_s: seconds between faults.
        reload: opens the page that shows the session anew.
        seed: of their order.
    """

    def __init__(self, rig: Rig, every_s: float, reload: Callable[[], None], seed: int = 0) -> None:
        assert isinstance(rig.robot, SimulatedGrblRobot) and isinstance(rig.tracker, SimulatedOpenIgtlTracker)
        assert isinstance(rig.camera, TwinCamera)
        self._robot, self._tracker, self._camera, self._every_s = rig.robot, rig.tracker, rig.camera, every_s
        self._reload_page = reload
        self._random, self._end = random.Random(seed), threading.Event()
        self.planted: dict[str, int] = {}
        self.sent_s = array("d")  # plain numbers: the soak's own memory must not grow as a list of floats would
        send = self._tracker.server.server.send_pose

        def counted(*arguments: object) -> int:
            reached = send(*arguments)  # type: ignore[arg-type]
            self.sent_s.extend([time.monotonic()] * reached)
            return reached

        self._tracker.server.server.send_pose = counted  # type: ignore[method-assign, assignment]
        self._send = counted

    def __enter__(self) -> "Faults":
        self._thread = threading.Thread(target=self._run, name="faults", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        kinds: list[Callable[[], None]] = [
            self._nan_pose, self._zero_pose, self._no_rotation, self._garbage, self._hang_up, self._silent_tracker,
            self._silent_board, self._board_reset, self._board_garbage, self._camera_mistake,
            self._reload_page_now,
        ]  # fmt: skip
        while not self._end.wait(self._every_s):
            fault = self._random.choice(kinds)
            self.planted[fault.__name__[1:]] = self.planted.get(fault.__name__[1:], 0) + 1
            fault()

    def _nan_pose(self) -> None:
        self._send(np.full((4, 4), np.nan), self._tracker.device)

    def _zero_pose(self) -> None:
        self._send(np.zeros((4, 4)), self._tracker.device)

    def _no_rotation(self) -> None:
        known = len(self.sent_s)
        self._send(3 * np.eye(4), self._tracker.device)
        del self.sent_s[known:]  # it is refused, and said

    def _garbage(self) -> None:
        for client in list(self._tracker.server.server._clients):
            client.send(self._random.randbytes(200))

    def _hang_up(self) -> None:
        for client in list(self._tracker.server.server._clients):
            client.shutdown(2)

    def _silent_tracker(self) -> None:
        sensor, self._tracker.server._sensor = self._tracker.server._sensor, lambda: None
        self._end.wait(2.0)
        self._tracker.server._sensor = sensor

    def _silent_board(self) -> None:
        self._robot.board.answering = False
        self._end.wait(3.0)
        self._robot.board.answering = True

    def _board_reset(self) -> None:
        os.write(self._robot.board_port._master, self._robot.board.power_cycle())

    def _board_garbage(self) -> None:
        os.write(self._robot.board_port._master, self._random.randbytes(60) + b"\r\n")

    def _reload_page_now(self) -> None:
        self._reload_page()

    def _camera_mistake(self) -> None:
        read = self._camera.read

        def once(timeout_s: float = 1.0) -> object:
            self._camera.read = read  # type: ignore[method-assign]
            raise ValueError("a driver's own mistake")

        self._camera.read = once  # type: ignore[method-assign, assignment]
