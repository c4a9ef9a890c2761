"""What a page may ask for: commands by name, values of their type, within their bounds."""

import json

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.page.commands import MOST_BYTES, Command, run_message


@pytest.fixture
def done():
    return []


@pytest.fixture
def commands(done):
    return {
        "stop": Command(lambda: done.append("stop")),
        "pilot": Command(done.append, bool),
        "seek": Command(done.append, float, 0.0, 10.0),
        "count": Command(done.append, int, 1, 1000),
        "drive": Command(done.append, str, choices=("left", "right")),
        "name": Command(done.append, str),
        "pick": Command(done.append, tuple[float, float, float]),
        "rename": Command(done.append, tuple[str, str]),
    }


RIGHT = [
    ("stop", None, "stop"), ("stop", [1, 2], "stop"), ("pilot", True, True), ("seek", 10, 10.0), ("count", 1000, 1000),
    ("drive", "left", "left"), ("name", "oberer Kelch, ä", "oberer Kelch, ä"), ("pick", [0, 1.5, -2], (0.0, 1.5, -2.0)),
    ("rename", ["A", "B"], ("A", "B")),
]  # fmt: skip
WRONG = [
    ("pilot", 1), ("pilot", "true"), ("seek", -0.1), ("seek", 10.1), ("seek", "5"), ("seek", None), ("seek", True),
    ("count", 0), ("count", -5), ("count", 1e9), ("count", 2.5), ("drive", "up"), ("drive", ""), ("drive", ["left"]),
    ("name", ""), ("name", "x" * 41), ("pick", [1, 2]), ("pick", [1, 2, 1e7]), ("pick", "abc"), ("pick", [1, 2, None]),
    ("rename", ["A"]), ("rename", ["A", ""]), ("rename", ["A", "B", "C"]), ("rename", [1, 2]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "expected"), RIGHT)
def test_a_value_of_its_type_within_its_bounds_is_taken(commands, done, name, value, expected):
    run_message(json.dumps({"do": name, "value": value}), commands)
    assert done == [expected]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_value_of_another_type_or_out_of_bounds_is_refused(commands, done, name, value):
    with pytest.raises(InputError, match="command's value"):
        run_message(json.dumps({"do": name, "value": value}), commands)
    assert done == []


@pytest.mark.parametrize(
    "raw",
    ["", "{", "7", "[]", "null", '{"do": "rm"}', '{"do": ["stop"]}', '{"value": 1}', '{"do": "seek", "value": NaN}',
     '{"do": "seek", "value": 1e999}', "[" * 4000, "x" * (MOST_BYTES + 1), 7, None],
)  # fmt: skip
def test_what_is_no_message_of_ours_is_refused(commands, done, raw):
    with pytest.raises(InputError):
        run_message(raw, commands)
    assert done == []
