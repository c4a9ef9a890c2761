"""One writer a result: an advisory lock beside it, which the system lets go when its process dies, however it dies."""

import errno
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from ursnav_torch.errors import InputError

try:
    import fcntl
except ImportError:  # Windows, where two runs are not kept apart
    fcntl = None  # type: ignore[assignment]

#: What file systems without locks answer; there two runs are not kept apart.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)

_guard = threading.Lock()
_own: set[Path] = set()


def lock_path(path: Path) -> Path:
    """The file whose lock says that somebody writes ``path``; empty of meaning once nobody holds it."""
    return path.with_name(path.name + ".lock")


def partial_path(path: Path) -> Path:
    """Where work in progress on ``path`` lies: beside it, so that the last step is one rename."""
    return path.with_name(path.name + ".partial")


@contextmanager
def locked(*paths: Path) -> Iterator[None]:
    """Be the only writer of results, and of the work in progress on them, within the block.

    A result inside this process's own work in progress needs no lock of its own.

    Raises:
        InputError: another process, or another thread of this one, writes one of them.
        OSError: no lock can be made there.
    """
    with ExitStack() as stack:
        for path in dict.fromkeys(path.absolute() for path in paths):
            if not _is_inside_own_work(path):
                stack.enter_context(_locked(path))
        yield


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    file, descriptor = lock_path(path), _acquire(path)
    with _guard:
        _own.add(partial_path(path))
    try:
        yield
    finally:
        with _guard:
            _own.discard(partial_path(path))
        file.unlink(missing_ok=True)  # while it is held: who waits for it finds another file, see `_acquire`
        os.close(descriptor)


def _acquire(path: Path) -> int:
    """Descriptor of the locked file, which is still the one of that name."""
    file = lock_path(path)
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            _flock(descriptor, path)
            if _is_named(descriptor, file):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _flock(descriptor: int, path: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        who = os.pread(descriptor, 200, 0).decode("utf-8", "replace").strip() or "another process"
        raise InputError(
            f"{path} is being written by {who}. Wait until that run is done, or choose another out=."
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def _is_named(descriptor: int, file: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(file))
    except FileNotFoundError:
        return False


def _is_inside_own_work(path: Path) -> bool:
    with _guard:
        return any(parent in _own for parent in path.parents)
