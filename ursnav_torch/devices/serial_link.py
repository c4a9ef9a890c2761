"""Bytes over a serial port, with a deadline on every read and one kind of error for a pulled plug."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError

LONGEST_LINE = 2048
POLL_S = 0.02

#: What pyserial raises when the device behind a port is gone.
_GONE: tuple[type[Exception], ...] = (serial.SerialException, OSError, TypeError)
with suppress(ImportError):  # Windows has no termios
    import termios

    _GONE += (termios.error,)


class SerialLink:
    """An open serial port; ``port`` is a device path or any URL that pyserial accepts.

    Raises:
        DeviceNotConnectedError: there is no such port, or it may not be opened.
    """

    def __init__(self, port: str, baud: int) -> None:
        self.port = port
        self._pending = bytearray()
        self._write_lock = threading.Lock()
        try:
            self._serial = serial.serial_for_url(port, baudrate=baud, timeout=POLL_S, write_timeout=1.0)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceNotConnectedError(
                f"Serial port {port} cannot be opened: {error}. Is the device plugged in and switched on, "
                "and may you use it (on Linux: are you in the group 'dialout')?"
            ) from error

    def close(self) -> None:
        """Close the port; closing twice does nothing."""
        self._serial.close()

    def fileno(self) -> int | None:
        """The port's file descriptor, None where the URL is of no real port."""
        try:
            return int(self._serial.fileno())
        except (OSError, AttributeError, serial.SerialException):
            return None

    def write(self, data: bytes) -> None:
        """Send ``data`` in one piece; threads do not mix theirs.

        Raises:
            DeviceNotConnectedError: the device was unplugged.
            DeviceTimeoutError: the device takes no bytes for a second.
        """
        with self._write_lock, self._unplugged():
            try:
                self._serial.write(data)
            except serial.SerialTimeoutException as error:
                raise DeviceTimeoutError(f"{self.port} took no bytes for 1 s; is it hung?") from error

    def read_exactly(self, count: int, timeout_s: float) -> bytes:
        """The next ``count`` bytes; raises as `read_until` does."""
        deadline = time.monotonic() + timeout_s
        while len(self._pending) < count:
            self._fill(deadline, f"{count} bytes")
        return self._take(count)

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes:
        """The next bytes up to ``terminator``, which is cut off.

        Raises:
            DeviceTimeoutError: it did not come within ``timeout_s``; what did come is kept for the next read.
            DeviceProtocolError: more than 2048 bytes came without it.
            DeviceNotConnectedError: the device was unplugged.
        """
        deadline = time.monotonic() + timeout_s
        while (end := self._pending.find(terminator)) < 0:
            if len(self._pending) > LONGEST_LINE:
                self._pending.clear()
                raise DeviceProtocolError(
                    f"{self.port} sent more than {LONGEST_LINE} bytes without an end of line: wrong baud rate?"
                )
            self._fill(deadline, "an end of line")
        return self._take(end + len(terminator))[:end]

    def read_available(self) -> bytes:
        """Whatever has come so far, without waiting."""
        with self._unplugged():
            if waiting := self._serial.in_waiting:
                self._pending += self._serial.read(waiting)
        return self._take(len(self._pending))

    def discard_input(self) -> None:
        """Forget everything received and not read."""
        self.read_available()

    def set_baud(self, baud: int) -> None:
        """Go on at another speed."""
        with self._unplugged():
            self._serial.baudrate = baud

    def send_break(self, duration_s: float = 0.25) -> None:
        """Hold the line low, which resets some devices; a pseudo-terminal swallows it."""
        with self._unplugged():
            self._serial.send_break(duration_s)

    def _take(self, count: int) -> bytes:
        taken = bytes(self._pending[:count])
        del self._pending[:count]
        return taken

    def _fill(self, deadline: float, wanted: str) -> None:
        with self._unplugged():
            waiting = self._serial.in_waiting  # has come in time, however late this program looks
            if waiting or time.monotonic() < deadline:
                self._pending += self._serial.read(max(1, waiting))
                return
        raise DeviceTimeoutError(
            f"{self.port} did not send {wanted} in time (so far {bytes(self._pending)!r}); is it switched on?"
        )

    @contextmanager
    def _unplugged(self) -> Iterator[None]:
        try:
            yield
        except (serial.SerialTimeoutException, DeviceTimeoutError):
            raise
        except _GONE as error:
            raise DeviceNotConnectedError(f"{self.port} is gone ({error}); was it unplugged?") from error
