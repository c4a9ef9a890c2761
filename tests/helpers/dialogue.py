"""Says a device's byte dialogue in a test: expected bytes in, answers out, through a real pseudo-terminal."""

import contextlib
import time
from collections.abc import Iterator

from ursnav_torch.simulation.port import SimulatedPort

Step = tuple[bytes, bytes]


class Dialogue:
    """A board that expects exactly these bytes, in this order, and gives these answers.

    ``again``, where set, may come any number of times before the next step: what a watchdog repeats while time passes.
    """

    def __init__(self, steps: list[Step]) -> None:
        self.steps = list(steps)
        self.received = bytearray()
        self.all_received = bytearray()
        self.surprise = b""
        self.again = b""

    def handle(self, data: bytes) -> bytes:
        self.received += data
        self.all_received += data
        answer = b""
        while self.received and not self.surprise:
            expected = self.steps[0][0] if self.steps else b""
            if self.steps and self.received.startswith(expected):
                answer += self.steps.pop(0)[1]
                del self.received[: len(expected)]
            elif self.steps and expected.startswith(self.received):
                break
            elif self.again and self.received.startswith(self.again):
                del self.received[: len(self.again)]
            else:
                self.surprise = bytes(self.received)
        return answer


@contextlib.contextmanager
def dialogue(steps: list[Step]) -> Iterator[tuple[str, Dialogue, SimulatedPort]]:
    """Yield a port's path with that dialogue behind it; all of it must have taken place at the end."""
    board = Dialogue(steps)
    port = SimulatedPort(board, period_s=0.001)
    try:
        yield port.path, board, port
        wait_until(lambda: not board.steps or bool(board.surprise), 0.3)
        assert board.surprise == b"", f"unexpected bytes {board.surprise!r}, hoped for {board.steps[:1]}"
        assert board.steps == [], f"never asked for {board.steps}"
        assert board.received == b"", f"left over: {bytes(board.received)!r}"
    finally:
        port.close()


def wait_until(condition, timeout_s: float = 20.0) -> bool:
    """Wait for a condition and say whether it came true; how soon it does is measured by benchmarks, not by tests."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.002)
    return bool(condition())
