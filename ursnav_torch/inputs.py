"""Files from outside, before anything is made of them: regular files only, and none without end."""

import os
import stat
from pathlib import Path

from ursnav_torch.errors import InputError

#: A minute of EM readings is 0.2 MB, a centerline 0.1 MB, a VID's description less: text beyond this is no such file.
MOST_TEXT_BYTES = 256 << 20


def read_regular(path: str | Path, what: str, most_bytes: int) -> bytes:
    """The bytes of a file that has an end.

    Args:
        path: the file.
        what: names the kind of file in errors.
        most_bytes: what such a file can hold at most.

    Raises:
        InputError: missing, not readable, larger, or a folder, pipe or device.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise InputError(f"The {what} {path} cannot be read: it is no regular file but a pipe or device.")
            data = file.read(most_bytes + 1)
    except FileNotFoundError:
        raise InputError(f"There is no {what} {path}.") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null byte
        if isinstance(error, InputError):
            raise
        raise InputError(f"The {what} {path} cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    if len(data) > most_bytes:
        raise InputError(
            f"The {what} {path} has {about.st_size / 1e6:.0f} MB; at most {most_bytes / 1e6:.0f} MB are read. Is it "
            "the right file?"
        )
    return data


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(
        path, flags | getattr(os, "O_NONBLOCK", 0)
    )  # else a pipe that nobody writes to holds the program for ever
