"""Two sessions never write one record, and the system's users decide who reads it."""

import os
import stat
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.session import Recorder


def test_a_record_that_is_being_written_is_not_overwritten(tmp_path: Path) -> None:
    with Recorder(tmp_path / "r"):
        with pytest.raises(InputError, match="is being written by process"), Recorder(tmp_path / "r", overwrite=True):
            pytest.fail("two writers")
    with Recorder(tmp_path / "r", overwrite=True):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


def test_a_refused_record_locks_nothing(tmp_path: Path) -> None:
    (tmp_path / "r.partial").mkdir()
    for _ in range(2):
        with pytest.raises(InputError, match="is an interrupted record"), Recorder(tmp_path / "r"):
            pytest.fail("another's record")
    assert [p.name for p in tmp_path.iterdir()] == ["r.partial"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_the_umask_decides_who_reads_it(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        with Recorder(tmp_path / "r"):
            pass
    finally:
        os.umask(before)
    modes = {stat.S_IMODE(p.stat().st_mode) for p in (tmp_path / "r").iterdir() if p.is_file()}
    assert modes == {0o666 & ~mask}
