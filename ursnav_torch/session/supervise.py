"""Supervision of device threads: no exception ends one silently; a device that fails is sought again and again."""

import logging
import threading
import time
from collections.abc import Callable

from ursnav_torch.devices import Device, SourceAtEndError
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError, DeviceTimeoutError, InputError

logger = logging.getLogger(__name__)
#: Pauses before a device is connected again: the first, each later one twice as long, and none longer than the last.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 15.0
#: Faults in a row after which a device that is still there is connected anew.
FAULTS_BEFORE_RECONNECT = 10
LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class Supervisor:
    """Runs the work of device threads; every fault becomes a note, a stop of the device, and a new connection.

    Args:
        note: what becomes of a note: level and text.
        end: ends all work.

    Attributes:
        outages_s: for how long each device gave nothing because it had failed or was silent.
    """

    def __init__(self, note: Callable[[str, str], None], end: threading.Event) -> None:
        self._note, self._end = note, end
        self.outages_s: dict[str, float] = {}

    def tell(self, level: str, text: str) -> None:
        """Say something worth telling, in the log and as a note."""
        logger.log(LEVELS[level], "%s", text)
        self._note(level, text)

    def run(self, device: Device, work: Callable[[], None]) -> None:
        """Do a device's work again and again, until the session or the device is at its end."""
        name, faults, well_s, silent = type(device).__name__, 0, time.monotonic(), False
        while not self._end.is_set():
            try:
                work()
                if silent or faults:
                    self._back(name, well_s, silent)
                faults, silent, well_s = 0, False, time.monotonic()
                continue
            except SourceAtEndError as error:
                self.tell("info", f"{name}: {error}")
                return
            except DeviceTimeoutError as error:
                if not silent:
                    self.tell("warning", f"{name}: {error}")
                silent = True
                continue
            except InputError as error:  # one picture that cannot be used
                self.tell("error", f"{name}: {error}")
                continue
            except DeviceError as error:
                text, gone = str(error), isinstance(error, DeviceNotConnectedError)
            except Exception as error:  # a driver's own mistake must not end its thread without a word
                logger.exception("%s failed.", name)
                text, gone = f"{type(error).__name__}: {error}", True
            faults += 1
            self.tell("error", f"{name}: {text}")
            if gone or faults >= FAULTS_BEFORE_RECONNECT:
                self._reconnect(device, name, well_s)
                faults, silent, well_s = 0, False, time.monotonic()

    def _back(self, name: str, since_s: float, silent: bool) -> None:
        """A device works again after it was silent, or after faults."""
        seconds = time.monotonic() - since_s
        self.outages_s[name] = self.outages_s.get(name, 0.0) + seconds
        if silent:
            self.tell("info", f"{name}: samples come again after {seconds:.1f} s")

    def _reconnect(self, device: Device, name: str, since_s: float) -> None:
        """Stop and close a device, and seek it again with growing pauses."""
        self._safely(device.disconnect, name)
        pause_s = FIRST_PAUSE_S
        while not self._end.wait(pause_s):
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
            if self._safely(device.connect, name):
                seconds = time.monotonic() - since_s
                self.outages_s[name] = self.outages_s.get(name, 0.0) + seconds
                self.tell("info", f"{name}: connected again after {seconds:.1f} s")
                return

    def _safely(self, action: Callable[[], None], name: str) -> bool:
        """Whether an action of a device succeeded; it may fail in any way."""
        try:
            action()
        except DeviceError as error:
            logger.info("%s: %s", name, error)
        except Exception:
            logger.exception("%s failed.", name)
        else:
            return True
        return False
