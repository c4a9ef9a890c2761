"""A pseudo-terminal with a simulated board behind it, so that real drivers run against true bytes."""

import os
import select
import threading
import time
from typing import Protocol


class SimulatedBoard(Protocol):
    """What a simulated board does: bytes in, bytes out, and time passing."""

    def handle(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answer; ``b""`` also lets time pass."""


class SimulatedPort:
    """Runs a board behind a pseudo-terminal in a thread; drivers open ``path`` as a serial port.

    The board goes on when the driver's process dies, as a real one does. Linux and macOS only. A serial break
    and the baud rate do not get through a pseudo-terminal.
    """

    def __init__(self, board: SimulatedBoard, period_s: float = 0.005) -> None:
        import tty  # here, so that what only replays can be imported where there is none

        self.board = board
        self._period_s = period_s
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._plugged = True
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="simulated-port", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Pull the plug: the driver's port is dead when this returns."""
        with self._lock:
            if not self._plugged:
                return
            self._plugged = False
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def close(self) -> None:
        """The same as `unplug`."""
        self.unplug()

    def _run(self) -> None:
        while self._plugged:
            readable, _, _ = select.select([self._master], [], [], self._period_s)
            self._serve(bool(readable))

    def _serve(self, readable: bool) -> None:
        data = os.read(self._master, 4096) if readable else b""
        answer = self.board.handle(data)
        deadline = time.monotonic() + 1.0
        while answer and time.monotonic() < deadline:
            try:
                answer = answer[os.write(self._master, answer) :]
            except BlockingIOError:  # nobody reads: a real port would lose the bytes too
                time.sleep(self._period_s)
                return
