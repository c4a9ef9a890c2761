"""What a disk refuses, as sentences: it is full, read-only, or another user's."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ursnav_torch.errors import InputError, UrsnavError

_FREE = "Free some space, then give the same command again; what is finished is kept."
_ELSEWHERE = "Choose another out=, or see to the folder's permissions."
#: What to do about what a disk refuses.
_DISK = {
    errno.ENOSPC: _FREE,
    errno.EDQUOT: _FREE,
    errno.EFBIG: _FREE,
    errno.EROFS: _ELSEWHERE,
    errno.EACCES: _ELSEWHERE,
    errno.EPERM: _ELSEWHERE,
    errno.EIO: "The disk is damaged or was taken away; choose another out=.",
}


@contextmanager
def disk_errors(*paths: Path) -> Iterator[None]:
    """What the disk refuses of results within the block becomes a sentence.

    Raises:
        InputError: the disk is full, read-only or out of the user's reach.
    """
    try:
        yield
    except UrsnavError:
        raise
    except Exception as error:
        name = getattr(error, "filename", None)
        mine = name is None or any(str(name).startswith(str(path)) for path in paths)
        sentence = disk_sentence(error, paths[0]) if mine else None
        if sentence is None:
            raise
        raise InputError(sentence) from error


def disk_sentence(error: BaseException, path: Path | None = None) -> str | None:
    """What to tell about a disk that refuses to write; None where it is another kind of error."""
    number = error.errno if isinstance(error, OSError) else None
    if number is None:  # libraries that write files themselves tell the cause in their own error's text
        number = next((n for n in _DISK if os.strerror(n) in str(error)), None)
    if number is None or number not in _DISK:
        return None
    where = path or getattr(error, "filename", None) or "The result"
    return f"{where} cannot be written: {os.strerror(number)}. {_DISK[number]}"
