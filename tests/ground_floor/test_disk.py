"""A full or read-only disk is told in a sentence, and leaves no half result."""

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from ursnav_torch.disk import disk_errors, disk_sentence
from ursnav_torch.errors import InputError
from ursnav_torch.files import check_output, whole_folder, write_csv, write_image

FULL = """
import resource, sys, pathlib
import numpy as np
from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_folder, write_image
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    with whole_folder(pathlib.Path(sys.argv[1])) as work:
        if sys.argv[2] == "picture":
            write_image(work / "x.png", np.random.default_rng(0).integers(0, 255, (99, 99), np.uint8))
        elif sys.argv[2] == "text":
            (work / "x.txt").write_text("x" * 9000)
        else:
            import torch
            from safetensors.torch import save_file
            save_file({"x": torch.zeros(9000)}, str(work / "x"))
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("what", ["picture", "text", "tensors"])
def test_a_file_that_finds_no_room_is_a_sentence_and_no_file(tmp_path: Path, what: str) -> None:
    out = tmp_path / "out"
    done = subprocess.run([sys.executable, "-c", FULL, str(out), what], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{out} cannot be written: File too large. Free some space, then give the same")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("number", "match"),
    [
        (errno.ENOSPC, "No space left on device. Free some space"),
        (errno.EDQUOT, "Free some space"),
        (errno.EROFS, "Read-only file system. Choose another out="),
        (errno.EACCES, "Permission denied. Choose another out="),
    ],
)
def test_what_the_disk_refuses_becomes_a_sentence(tmp_path: Path, number: int, match: str) -> None:
    with pytest.raises(InputError, match=match), whole_folder(tmp_path / "out"):
        raise OSError(number, "in the library's own words")
    assert not list(tmp_path.iterdir())


def test_other_errors_and_other_files_stay_what_they_are(tmp_path: Path) -> None:
    assert disk_sentence(ValueError("no")) is None and disk_sentence(OSError(errno.EINVAL, "no")) is None
    with pytest.raises(PermissionError), disk_errors(tmp_path / "out"):
        raise PermissionError(errno.EACCES, "an input that may not be read", str(tmp_path / "input.stl"))


def test_a_folder_that_cannot_be_written_to_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(InputError, match=r"cannot be written to: it is read-only or another user's"):
        check_output(tmp_path / "out", False)
    with pytest.raises(InputError, match="read-only"):
        write_csv(tmp_path / "out.csv", ["a"], [])


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    import numpy as np

    with pytest.raises(FileNotFoundError):
        write_image(tmp_path / "nowhere" / "x.png", np.zeros((8, 8), np.uint8))
    write_image(tmp_path / "x.jpg", np.zeros((8, 8), np.uint8), 88)
    assert (tmp_path / "x.jpg").read_bytes()[:3] == b"\xff\xd8\xff"
