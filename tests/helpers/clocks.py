"""Time for tests: a clock that runs only when told, and patience with a busy machine."""

import contextlib
import signal
import time
from collections.abc import Iterator
from types import FrameType, SimpleNamespace

import pytest

#: What does not end within this time on any machine hangs; nothing that works takes a tenth of it.
HANGS_S = 30.0


class Clock:
    """Simulated time in seconds: to sleep takes none, and is added up.

    Attributes:
        now_s: the time; may be set.
        slept: every wait, in order.
    """

    def __init__(self, now_s: float = 100.0) -> None:
        self.now_s, self.slept = now_s, list[float]()

    def monotonic(self) -> float:
        """What ``time.monotonic`` would give."""
        return self.now_s

    def sleep(self, seconds: float) -> None:
        """What ``time.sleep`` would do."""
        self.slept.append(seconds)
        self.now_s += seconds


def runs_on(clock: Clock, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put one module of the package on a clock; others go by the machine's own."""
    faked = SimpleNamespace(monotonic=clock.monotonic, sleep=clock.sleep, time=time.time)
    monkeypatch.setattr(f"{module}.time", faked)


@contextlib.contextmanager
def does_not_hang(seconds: float = HANGS_S) -> Iterator[None]:
    """Interrupt what hangs; how long it takes otherwise, which depends on the machine, does not matter."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"hangs: not finished after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
