"""Work ahead in child processes: results in the order of the tasks, the same with any number of processes."""

import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_all_start_methods, get_context, parent_process
from multiprocessing.context import BaseContext
from typing import Any, TypeVar

import cv2
import torch

from ursnav_torch.errors import UrsnavError

Task = TypeVar("Task")
Result = TypeVar("Result")

#: Tasks that wait for each child, so that it never waits for one.
_AHEAD = 8
#: What children need and take seconds to import; by name, as this module is below them all.
_IMPORTED_ONCE = ["ursnav_torch.localization", "ursnav_torch.rendering"]
_work: Callable[[Any], Any] | None = None


def child_context() -> BaseContext:
    """How child processes start: forked from a server that has imported all once, or anew where there is none."""
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED_ONCE)
    return context


def spare_children(workers: int | None = None) -> int:
    """How many children may work beside this process: all cores but one when ``workers`` is None."""
    return max((workers or os.cpu_count() or 1) - 1, 0)


def busy_children(workers: int | None = None) -> int:
    """How many children may work while this process has little to do: all cores, 0 where there is one."""
    spare = spare_children(workers)
    return spare + 1 if spare else 0


def in_order(make: Callable[[], Callable[[Task], Result]], tasks: Iterable[Task], children: int) -> Iterator[Result]:
    """Yield ``make()(task)`` of every task, in their order.

    Args:
        make: called once in every process, which it must be possible to send it to.
        tasks: taken as they are needed: what makes them runs here while the children work.
        children: processes beside this one; 0 does all of it here.

    Raises:
        UrsnavError: a child ended before its work did.
    """
    if children <= 0:
        yield from map(make(), tasks)
        return
    initargs = (pickle.dumps(make),)
    with ProcessPoolExecutor(children, child_context(), initializer=_begin, initargs=initargs) as pool:
        waiting: deque[Future[bytes]] = deque()
        try:
            for task in tasks:
                waiting.append(pool.submit(_do, pickle.dumps(task)))
                if len(waiting) > _AHEAD * children:
                    yield pickle.loads(waiting.popleft().result())
            while waiting:
                yield pickle.loads(waiting.popleft().result())
        except BrokenProcessPool:
            raise UrsnavError(
                "A process that shared the work ended before its time; was there too little memory? workers=1 does "
                "all of it in one."
            ) from None
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def start_worker() -> None:
    """One thread a worker; the first process alone answers Ctrl-C, and no worker outlives it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


# Bytes and no tensors go from process to process: PyTorch would send those by shared memory, which may be scarce.
def _begin(make: bytes) -> None:
    global _work
    start_worker()
    _work = pickle.loads(make)()


def _do(task: bytes) -> bytes:
    assert _work is not None
    return pickle.dumps(_work(pickle.loads(task)))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
