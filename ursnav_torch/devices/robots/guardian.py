"""A second watchdog, in a process of its own: it stops the robot when the program that drives it is frozen or dead.

The interpreter's lock, a stopped process and a crash hold back every thread of the driving program, its watchdog
included. The board's own horizon ends the motion then; this process is for boards that would not.

The driving program writes a byte to a pipe with every command: ``+`` while it is armed, ``-`` when it is not. Where an
armed one is silent for too long, or has died, the stop is written to the robot's own port. This file imports nothing
but the standard library, so that it starts at once and needs little memory.
"""

import os
import select
import struct
import subprocess
import sys
from contextlib import suppress

ARMED, DISARMED = b"+", b"-"
#: A guardian that leaves so many words unread hangs: commands come 15 to 60 times a second.
UNREAD = 60


class Guardian:
    """Watches over one or more open ports from a process of its own.

    Args:
        stops: for each port its file descriptor, and the bytes that stop what hangs on it.
        silence_s: how long an armed program may be silent.
    """

    def __init__(self, stops: dict[int, bytes], silence_s: float) -> None:
        read_end, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        words = [f"{fd}:{stop.hex()}" for fd, stop in stops.items()]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, str(read_end), str(silence_s), *words],
            pass_fds=(read_end, *stops),
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C and Ctrl-Z are for the driving program alone
        )
        os.close(read_end)

    @property
    def is_alive(self) -> bool:
        """Whether it watches: it runs, and reads what it is told."""
        import fcntl  # where there is no POSIX the drivers can still be imported
        import termios

        if self._process.poll() is not None:
            return False
        try:
            told = fcntl.ioctl(self._pipe, termios.FIONREAD, struct.pack("i", 0))
        except OSError:  # it is being closed
            return False
        return bool(struct.unpack("i", told)[0] < UNREAD)

    def feed(self, armed: bool) -> None:
        """Say that the program runs; never waits."""
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._pipe, ARMED if armed else DISARMED)

    def close(self) -> None:
        """End it without a stop: the port is closed in good order."""
        self.feed(False)
        os.close(self._pipe)
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def watch(pipe: int, silence_s: float, stops: dict[int, bytes]) -> None:
    """What the process does until the pipe ends."""
    armed = False
    while True:
        ready, _, _ = select.select([pipe], [], [], silence_s if armed else None)
        data = os.read(pipe, 4096) if ready else b""
        if ready and data:
            armed = data[-1:] == ARMED
            continue
        if armed:
            for port, stop in stops.items():
                with suppress(OSError):  # one dead port must not keep the others going
                    os.write(port, stop)
            armed = False
        if ready:  # the pipe ended: the program is gone
            return


if __name__ == "__main__":
    numbers = [word.split(":") for word in sys.argv[3:]]
    watch(int(sys.argv[1]), float(sys.argv[2]), {int(fd): bytes.fromhex(stop) for fd, stop in numbers})
