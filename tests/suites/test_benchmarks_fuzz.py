"""Half a minute of the fuzzer with a fixed seed, and what it once found, in small."""

import random
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import fuzz
from benchmarks.fuzzing.discover import find_readers
from benchmarks.fuzzing.feed import says_the_same
from benchmarks.fuzzing.mutate import mutate


def test_readers_are_found_by_their_signatures() -> None:
    found = {reader.name: reader.takes for reader in find_readers()}
    assert found["camera.read.load_camera"] == "path"
    assert found["vid.store.load_vid"] == found["session.replay.Replay"] == "path"
    assert found["devices.igtl.messages.unpack_transform"] == "bytes"
    assert len(found) >= 35


def test_inputs_are_made_from_their_numbers_alone() -> None:
    good = b'{"a": [1, 2.5], "b": "x"}\n' * 3
    made = [mutate(good, [good], random.Random(number)) for number in range(200)]
    assert made == [mutate(good, [good], random.Random(number)) for number in range(200)]
    assert len(set(made)) > 150 and good not in made[:1]


def test_json_of_equal_content_was_not_altered() -> None:
    assert says_the_same(b'{"a": 1, "b": 2}', b'{"b":2,\n"a":1}') and says_the_same(b"\x00", b"\x00")
    assert not says_the_same(b'{"a": 1}', b'{"a": 2}') and not says_the_same(b"\x00", b"\x01")


def test_memory_of_whoever_started_the_fuzzer_is_not_counted() -> None:
    held = np.ones(800 << 20, np.uint8)  # touched, so it is really there
    said = subprocess.run(
        [sys.executable, "-c", "from benchmarks.fuzzing.feed import peak_mb; print(peak_mb())"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 10 < float(said.stdout) < held.nbytes >> 20


@pytest.mark.slow
def test_half_a_minute_of_fuzzing_finds_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["seconds=30", "seed=7"]) == 0, capfd.readouterr().out
