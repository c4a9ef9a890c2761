"""Where the work of a build is done: in this process and its children, or on the workers of a Dask cluster.

Both run the same functions on the same tasks, one thread each, so what they write is the same, byte for byte.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.processes import child_context, start_worker
from ursnav_torch.vid.store import package_version

Result = TypeVar("Result")
_shared: Any = None  # of a worker's tasks, which is sent to it once


class Compute(Protocol):
    """Runs many tasks of one kind."""

    def map(self, work: Callable[..., Result], shared: Any, tasks: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
        """Yield the results of ``work(shared, *task)``, in the order in which they end."""

    def check_folder(self, folder: Path) -> None:
        """Refuse a folder that the work cannot be written to."""


@dataclass(frozen=True, slots=True)
class LocalCompute:
    """``compute=local``: processes here; all cores when ``workers`` is None, none besides this one when it is 1."""

    workers: int | None = None

    def map(self, work: Callable[..., Result], shared: Any, tasks: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
        """See `Compute.map`."""
        workers = min(self.workers or os.cpu_count() or 1, len(tasks))
        if workers <= 1:
            with _one_thread():
                for task in tasks:
                    yield work(shared, *task)
            return
        with ProcessPoolExecutor(workers, child_context(), initializer=_begin, initargs=(shared,)) as pool:
            pending = {pool.submit(_with_what_is_shared, work, task) for task in tasks}
            try:
                yield from _as_they_end(pending)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise

    def check_folder(self, folder: Path) -> None:
        """Any folder of this machine will do."""


@dataclass(frozen=True, slots=True)
class DaskCompute:
    """``compute=dask``: the workers of a running scheduler; what they write lies in a folder that all of them share.

    A worker that is lost costs what it was doing: its tasks go to others, and so does what they share.

    Attributes:
        address: of the scheduler, ``tcp://HOST:PORT``.
        wait_s: for the scheduler and its first worker.
    """

    address: str
    wait_s: float = 30.0

    def map(self, work: Callable[..., Result], shared: Any, tasks: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
        """See `Compute.map`.

        Raises:
            InputError: the scheduler cannot be reached, has no worker, or goes away; or a task kills its workers.
        """
        distributed = import_extra("distributed", "dask", "compute=dask")
        with _client(self) as client:
            # A task and no scattered data: the scheduler makes it anew when its worker is lost.
            base = client.submit(_same, shared, pure=False)
            futures = [client.submit(_with_one_thread, work, base, task, pure=False) for task in tasks]
            try:
                for future in distributed.as_completed(futures):
                    yield future.result()
                    future.release()
            except (distributed.KilledWorker, distributed.CancelledError, OSError) as error:
                raise InputError(
                    f"The cluster at {self.address} gave up ({type(error).__name__}: {error}). What is finished is "
                    "kept: see to scheduler and workers (memory?), then the same command goes on."
                ) from None
            finally:
                client.cancel(futures)

    def check_folder(self, folder: Path) -> None:
        """Refuse a folder that a worker does not see, or workers of another version.

        Raises:
            InputError: naming the worker.
        """
        mark = folder / ".seen_by_all"
        text = os.urandom(8).hex()
        mark.write_text(text)
        try:
            with _client(self) as client:
                answers = client.run(_look, mark)
        finally:
            mark.unlink(missing_ok=True)
        for worker, (seen, version) in sorted(answers.items()):
            if seen != text:
                raise InputError(
                    f"The worker {worker} does not see the folder {folder}: out= must name a folder that this machine "
                    "and all workers share, under one and the same path."
                )
            if version != package_version():
                raise InputError(f"The worker {worker} has ursnav-torch {version}, here it is {package_version()}.")


@contextmanager
def _client(compute: DaskCompute) -> Iterator[Any]:
    distributed = import_extra("distributed", "dask", "compute=dask")
    try:
        client = distributed.Client(compute.address, timeout=compute.wait_s, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"No Dask scheduler answers at {compute.address!r} ({type(error).__name__}). Start one with 'dask "
            "scheduler', workers with 'dask worker tcp://HOST:8786 --nthreads 1', and give compute.address=."
        ) from None
    try:
        client.wait_for_workers(1, timeout=compute.wait_s)
        with client.as_current():
            yield client
    except TimeoutError:
        raise InputError(
            f"The scheduler at {compute.address} has no worker; start some with 'dask worker {compute.address} "
            "--nthreads 1'."
        ) from None
    finally:
        client.close()


def _begin(shared: Any) -> None:
    global _shared
    start_worker()
    _shared = shared


def _with_what_is_shared(work: Callable[..., Result], task: tuple[Any, ...]) -> Result:
    return work(_shared, *task)


def _same(value: Result) -> Result:
    return value


def _with_one_thread(work: Callable[..., Result], shared: Any, task: tuple[Any, ...]) -> Result:
    torch.set_num_threads(1)
    return work(shared, *task)


def _look(mark: Path) -> tuple[str | None, str]:
    try:
        return mark.read_text(encoding="utf-8"), package_version()
    except OSError:
        return None, package_version()


def _as_they_end(pending: set[Future[Result]]) -> Iterator[Result]:
    while pending:
        done, pending = wait(pending, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Operations on pictures are too small to share, and as many threads as in a worker give the same bytes."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
