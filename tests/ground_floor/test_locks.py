"""Two runs never write one result; what holds them apart ends with the process, however it ends."""

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_file, whole_folder
from ursnav_torch.locks import lock_path, locked

HOLD = """
import sys, pathlib
from ursnav_torch.locks import locked
with locked(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path: Path):
    """Another process that writes ``tmp_path / "out"``."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "out")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_writer_is_refused_and_told_who_the_first_is(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    said = rf"out is being written by process {holder.pid} on .*Wait until that run is done, or choose another out="
    for make in (whole_file, whole_folder):
        with pytest.raises(InputError, match=said), make(tmp_path / "out"):
            pytest.fail("two writers")
    with locked(tmp_path / "other"):
        pass


@pytest.mark.parametrize("ended", [signal.SIGKILL, signal.SIGTERM])
def test_a_dead_writer_holds_nothing(tmp_path: Path, holder: subprocess.Popen[str], ended: signal.Signals) -> None:
    holder.send_signal(ended)
    holder.wait()
    assert lock_path(tmp_path / "out").exists()
    with whole_file(tmp_path / "out") as partial:
        partial.write_text("mine")
    assert [p.name for p in tmp_path.iterdir()] == ["out"], "and no trace is left"


def test_threads_are_kept_apart_too_but_not_from_their_own_work(tmp_path: Path) -> None:
    with locked(tmp_path / "out"):
        with pytest.raises(InputError, match=f"process {os.getpid()}"), locked(tmp_path / "out"):
            pytest.fail("two writers")
        inside = tmp_path / "out.partial" / "rows.csv"
        with locked(inside):
            assert not lock_path(inside).exists()
    with locked(tmp_path / "out"):
        pass


def test_one_of_many_at_once_wins_each_time(tmp_path: Path) -> None:
    """The lock's file is removed and made anew all the time; still nobody is inside with another."""
    inside, most, refused = [0], [0], [0]

    def work() -> None:
        for _ in range(60):
            try:
                with locked(tmp_path / "out"):
                    inside[0] += 1
                    most[0] = max(most[0], inside[0])
                    inside[0] -= 1
            except InputError:
                refused[0] += 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1] and not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_still_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", none)
    with whole_file(tmp_path / "out") as partial:
        partial.write_text("x")
    assert (tmp_path / "out").read_text(encoding="utf-8") == "x"
