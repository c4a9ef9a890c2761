"""The same build on this machine and on a cluster, a worker lost on the way."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import DaskCompute, LocalCompute, PlanSettings, build_vid

pytest.importorskip("distributed", reason="the extra dask is not installed")
PLAN = PlanSettings(views_per_calyx=50, passage_views=100)


def squared(shared: int, value: int) -> int:
    if value < 0:
        raise InputError("no roots here")
    return shared + value * value


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Start]:
    """Starts processes of Dask, which end with the module."""
    folder = tmp_path_factory.mktemp("dask")
    log = (folder / "log.txt").open("wb")
    running: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
        running.append(subprocess.Popen(command, cwd=folder, stdout=log, stderr=log, env=environment))
        return running[-1]

    yield start
    for process in reversed(running):
        process.kill()
        process.wait()
    log.close()


@pytest.fixture(scope="module")
def address(start: Start, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of a scheduler on loopback."""
    path = tmp_path_factory.mktemp("scheduler") / "scheduler.json"
    start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(path))
    until = time.monotonic() + 60
    while not path.exists() or not path.read_text(encoding="utf-8"):
        assert time.monotonic() < until, "no scheduler"
        time.sleep(0.1)
    return str(json.loads(path.read_text(encoding="utf-8"))["address"])


@pytest.fixture
def worker(start: Start, address: str) -> Callable[[], subprocess.Popen[bytes]]:
    return lambda: start("worker", address, "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")


def test_local_work_gives_every_result_once() -> None:
    for workers in (1, 2):
        assert sorted(LocalCompute(workers).map(squared, 100, [(i,) for i in range(5)])) == [100, 101, 104, 109, 116]
        with pytest.raises(InputError, match="no roots here"):
            list(LocalCompute(workers).map(squared, 0, [(1,), (-1,), (2,)]))


def test_no_scheduler_is_said_with_what_to_do() -> None:
    compute = DaskCompute("tcp://127.0.0.1:9", wait_s=0.5)
    with pytest.raises(InputError, match=r"No Dask scheduler answers at 'tcp://127.0.0.1:9'.*dask scheduler"):
        list(compute.map(squared, 0, [(1,)]))
    with pytest.raises(InputError, match="No Dask scheduler answers at 'nonsense://x'"):
        list(DaskCompute("nonsense://x", wait_s=0.5).map(squared, 0, [(1,)]))


@pytest.mark.slow
def test_a_cluster_builds_the_same_bytes_though_a_worker_dies(
    phantom: Kidney, lens: Camera, tmp_path: Path, address: str, worker: Callable[[], subprocess.Popen[bytes]]
) -> None:
    build = partial(build_vid, phantom, lens, DefaultSettings(), RaycastRenderer, PLAN)
    build(tmp_path / "local", workers=1)
    with pytest.raises(InputError, match=f"The scheduler at {address} has no worker"):
        build(tmp_path / "vid", compute=DaskCompute(address, wait_s=0.5))
    first, _ = worker(), worker()
    compute = DaskCompute(address)
    assert sorted(compute.map(squared, 1, [(2,), (3,)])) == [5, 10]
    with pytest.raises(InputError, match="no roots here"):
        list(compute.map(squared, 0, [(-1,)]))

    class Killing:
        """Progress that ends a worker when a third of the views is there."""

        def __init__(self, total: int, what: str) -> None:
            self.done, self.total = 0, total

        def __enter__(self) -> Callable[[int], None]:
            return self.advance

        def __exit__(self, *_: object) -> None:
            assert self.done == self.total

        def advance(self, views: int) -> None:
            self.done += views
            if self.done > self.total / 3 and first.poll() is None:
                first.send_signal(signal.SIGKILL)
                first.wait()

    build(tmp_path / "vid", compute=compute, progress=Killing)
    assert first.returncode == -signal.SIGKILL
    assert content(tmp_path / "vid") == content(tmp_path / "local")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["local", "vid"], "committed once, and nothing left over"
