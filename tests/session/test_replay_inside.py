"""A record names its own pictures only: a replay reads nothing else, whatever the lines say."""

import json
import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from ursnav_torch.session import Replay

PNG = cv2.imencode(".png", np.zeros((16, 16), np.uint8))[1].tobytes()


def record(folder: Path, name: str) -> Replay:
    """A record with one picture, whose line names a file."""
    line = {"kind": "frame", "stamp": [0, 1.0, 2.0], "file": name, "bytes": len(PNG), "crc32": zlib.crc32(PNG)}
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    (folder / "events.jsonl").write_text(json.dumps(line | {"kept": True, "suffix": "png", "source": "x"}) + "\n")
    return Replay(folder, speed=0)


def test_a_picture_of_the_record_is_read(tmp_path: Path) -> None:
    (tmp_path / "r" / "frames").mkdir(parents=True)
    (tmp_path / "r" / "frames" / "0.png").write_bytes(PNG)
    assert len(list(record(tmp_path / "r", "frames/0.png"))) == 1


@pytest.mark.parametrize("name", ["{outside}", "../outside.png", "frames/../../outside.png", "frames/link.png",
                                  "frames/pipe", "/dev/zero", "frames", "a\0b"])  # fmt: skip
def test_no_other_file_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "outside.png").write_bytes(PNG)
    (tmp_path / "r" / "frames").mkdir(parents=True)
    (tmp_path / "r" / "frames" / "link.png").symlink_to(tmp_path / "outside.png")
    os.mkfifo(tmp_path / "r" / "frames" / "pipe")
    replay = record(tmp_path / "r", name.replace("{outside}", str(tmp_path / "outside.png")))
    assert list(replay) == [] and replay.damaged == 1


@pytest.mark.parametrize("line", [b"[" * 5000, b"x" * (1 << 21), b'{"kind":[],"stamp":[0,1,2]}',
                                  b'{"kind":"result","stamp":null,"frame":[]}'])  # fmt: skip
def test_lines_that_are_none_are_counted(tmp_path: Path, line: bytes) -> None:
    replay = record(tmp_path / "r", "frames/0.png")
    (tmp_path / "r" / "events.jsonl").write_bytes(line + b"\n")
    assert list(replay) == [] and replay.results() == [] and replay.damaged >= 1
    assert replay.duration_s() >= 0


@pytest.mark.parametrize("about", ["[]", '{"format": []}', '{"format": "x"}', "[" * 2000])
def test_a_description_that_is_none_tells_nothing(tmp_path: Path, about: str) -> None:
    record(tmp_path / "r", "frames/0.png")
    (tmp_path / "r" / "session.json").write_text(about)
    assert Replay(tmp_path / "r").about == {}
