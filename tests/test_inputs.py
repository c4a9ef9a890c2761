"""Files from outside have an end, and nothing waits for one that has none."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.features import read_image
from ursnav_torch.inputs import read_regular
from ursnav_torch.records import read_json
from ursnav_torch.tables import read_csv

READERS: list[Callable[[Path], object]] = [
    lambda path: read_regular(path, "thing", 100),
    lambda path: read_json(path, "camera"),
    lambda path: read_csv(path, ["a"], "poses"),
    read_image,
]


@pytest.mark.parametrize("read", READERS, ids=["bytes", "json", "csv", "image"])
def test_pipes_and_devices_are_refused_at_once(tmp_path: Path, read: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match="no regular file but a pipe or device"):
            read(path)
    with pytest.raises(InputError, match="Is a directory"):
        read(tmp_path)
    with pytest.raises(InputError, match="There is no"):
        read(tmp_path / "nowhere")


def test_a_larger_file_than_its_kind_can_be_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "big").open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(InputError, match=r"The thing .*big has 10737 MB; at most 1 MB are read"):
        read_regular(tmp_path / "big", "thing", 1_000_000)
    assert read_regular(__file__, "test", 1_000_000) == Path(__file__).read_bytes()
