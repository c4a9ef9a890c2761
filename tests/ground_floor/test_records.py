"""Plain data become records, and what is none is refused by the package's own error."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.records import read_json, to_record


@dataclass(frozen=True)
class Ball:
    radius_mm: float
    center_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.radius_mm <= 0:
            raise InputError(f"radius_mm={self.radius_mm} must be positive.")


def test_fields_have_their_types_and_their_defaults() -> None:
    assert to_record({"radius_mm": 2, "color": "red"}, Ball, "x") == Ball(2.0)
    assert to_record({"radius_mm": 2.5, "center_mm": [1, 2, 3]}, Ball, "x").center_mm == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ({}, "ball.json cannot be used: Object missing required field `radius_mm`"),
        ({"radius_mm": "2"}, r"Expected `float`, got `str` - at `\$.radius_mm`"),
        ({"radius_mm": True}, "Expected `float`, got `bool`"),
        ({"radius_mm": 1, "center_mm": [1, 2]}, "length 3"),
        ({"radius_mm": -1}, "radius_mm=-1.0 must be positive"),
        ([1], "Expected `object`, got `array`"),
    ],
)
def test_refuses_what_is_no_such_record(data: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        to_record(data, Ball, "ball.json")


def test_unknown_keys_are_refused_where_that_is_asked_for() -> None:
    with pytest.raises(InputError, match=r"cannot hold color; known are radius_mm, center_mm"):
        to_record({"radius_mm": 2, "color": "red"}, Ball, "ball.json", only_known=True)


@pytest.mark.parametrize("text", ["", "{", '{"a": NaN}', '{"a": 1e400}', "[" * 100_000, "\udcff"])
def test_text_that_is_no_json_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "ball.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=r"The ball file .*ball\.json is not readable JSON"):
        read_json(tmp_path / "ball.json", "ball")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "ball.json").write_bytes(b'\xef\xbb\xbf{"radius_mm": 1}')
    assert read_json(tmp_path / "ball.json", "ball") == {"radius_mm": 1}


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no ball file"):
        read_json(tmp_path / "none.json", "ball")
    with pytest.raises(InputError, match="cannot be read"):
        read_json(tmp_path, "ball")


@pytest.mark.parametrize("opened", ["[", '{"a":'])
def test_nesting_that_no_file_needs_is_refused(tmp_path: Path, opened: str) -> None:
    closed = "]" if opened == "[" else "}"
    for depth, fine in ((30, True), (33, False), (500, False)):
        (tmp_path / "ball.json").write_text(opened * depth + "1" + closed * depth)
        if fine:
            read_json(tmp_path / "ball.json", "ball")
        else:
            with pytest.raises(InputError, match=r"not readable JSON"):
                read_json(tmp_path / "ball.json", "ball")
