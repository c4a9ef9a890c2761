"""Small tensor work on one thread, large work in chunks over a few.

PyTorch splits every operation over all threads and waits for each of them; on operations shorter than some
milliseconds that waiting costs more than it gains. Here whole chunks go to threads instead, and each operation
stays on its own.
"""

import ctypes
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

#: Below this many multiply-adds in all, a second thread is not worth waking.
_WORTH_A_THREAD = 2e8

#: Allocator arenas that all threads of a long session share, and glibc's number for that setting. With one for each
#: thread, as usual, what one thread freed serves no other: a session of sixteen threads grew by 0.27 MiB a
#: minute, with two arenas by 0.05 (``python -m benchmarks.session minutes=30 faults_every_s=10``).
_ARENAS, _M_ARENA_MAX = 2, -8

T = TypeVar("T")

_lock = threading.Lock()
_inside = 0  # entries that have not been left, of all threads
_outside = 1  # threads an operation, as set outside


def share_arenas() -> bool:
    """Let all threads of this process allocate from few arenas; False where the C library is not glibc."""
    try:
        return bool(ctypes.CDLL(None).mallopt(_M_ARENA_MAX, _ARENAS))
    except (AttributeError, OSError, TypeError):  # musl, macOS, Windows
        return False


@contextmanager
def one_thread_an_operation() -> Iterator[int]:
    """Keep PyTorch's operations on one thread each inside; yields the thread count that was set outside.

    PyTorch counts for each calling thread by itself, and sums are rounded otherwise by two: so every thread that works
    at a picture enters, or the same pictures give other answers from run to run.
    """
    global _inside, _outside
    before = torch.get_num_threads()
    with _lock:
        _outside = before if _inside == 0 else _outside
        _inside += 1
        threads = _outside
    if before > 1:
        torch.set_num_threads(1)
    try:
        yield threads
    finally:
        if before > 1:
            torch.set_num_threads(before)
        with _lock:
            _inside -= 1


def meanwhile(work: Callable[[], T]) -> Callable[[], T]:
    """Start ``work`` beside what follows; what is given back waits for its end and gives what it gave, or its error.

    Where PyTorch was given a single thread, the work is done when it is asked for.
    """
    with _lock:
        threads = _outside if _inside else torch.get_num_threads()
    if threads == 1:
        return work
    done: Future[T] = Future()
    inference = torch.is_inference_mode_enabled()

    def run() -> None:
        try:
            # the caller's mode, which threads do not inherit
            with torch.inference_mode(inference), one_thread_an_operation():
                done.set_result(work())
        except BaseException as error:  # it is raised again where the result is asked for
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return done.result


def map_chunks(work: Callable[[slice], None], count: int, chunk: int, cost: float) -> None:
    """Call `work` on slices of at most `chunk` that cover ``range(count)``.

    Args:
        work: must be safe to call from several threads on different slices.
        count: items in all.
        chunk: items a slice.
        cost: multiply-adds in all; decides whether more than one thread is used.
    """
    pieces = max(1, -(-count // chunk))
    even = max(1, -(-count // pieces))
    parts = [slice(start, min(start + even, count)) for start in range(0, count, even)]
    with one_thread_an_operation() as threads:
        if threads == 1 or len(parts) <= 1 or cost < _WORTH_A_THREAD:
            for part in parts:
                work(part)
            return
        inference = torch.is_inference_mode_enabled()

        def run(part: slice) -> None:
            # the caller's mode, which threads do not inherit
            with torch.inference_mode(inference), one_thread_an_operation():
                work(part)

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, parts))
