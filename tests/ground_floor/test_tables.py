"""One strict reader for every CSV: nothing is dropped, guessed or taken for another number than it says."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.tables import Row, number, numbers, read_csv, whole_number


def write(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "rows.csv"
    path.write_bytes(content)
    return path


def row(text: str) -> Row:
    return Row({"x_mm": text}, Path("p.csv"), 4)


def test_byte_order_marks_further_columns_and_blanks_after_commas_are_taken(tmp_path: Path) -> None:
    rows = read_csv(write(tmp_path, "\ufeffa, b,c\r\n1,2, 3\r\n".encode()), ["b", "a"], "poses")
    assert rows == [{"a": "1", "b": "2", "c": "3"}]


def test_rows_know_their_lines_past_blank_lines_and_quoted_line_ends(tmp_path: Path) -> None:
    rows = read_csv(write(tmp_path, b'a,b\n\n1,"two\nlines"\n,\n \n3,4\n,\n,\n'), ["a"], "poses")
    assert [r.line for r in rows] == [3, 5, 7]
    assert rows[0]["b"] == "two\nlines"


def test_blank_cells_of_a_spreadsheet_beyond_the_header_are_no_fault(tmp_path: Path) -> None:
    assert read_csv(write(tmp_path, b"a,b,,\n1,2,,\n3,4,,,, \n"), ["a"], "poses")[1] == {"a": "3", "b": "4"}


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "has no rows; expected the columns a,b"),
        (b"a,b\n", "has no rows"),
        (b"\n\n", "has no rows"),
        (b"a,c\n1,2\n", r"lacks the column\(s\) b; it has a, c"),
        (b"a,b,a\n1,2,3\n", r"column\(s\) a twice"),
        (b"a, b,b \n1,2,3\n", r"column\(s\) b twice"),
        (b"a,b\n12,5,7,25,3,0\n", r"line 2 has 6 cells, the header 2; are there decimal commas\?"),
        (b"a,b\n1,2\n\n3\n", r"line 4 has 1 cells, the header 2; was the file cut off"),
        (b"a,b,\n1,2,3\n", r"line 2: the cell '3' stands in a column without a name"),
        (b"a;b\n12,5;7,25\n", "has semicolons between its cells; save it with commas"),
        (b"a\tb\n1\t2\n", "has tabs between its cells"),
        (b"a,b\n\xff\xfe\x00,1\n", "not readable as CSV: it is no text in UTF-8"),
        ("a,b\n1,2\n".encode("utf-16"), "no text in UTF-8"),
        (b'a,b\n1,"2\n', r"not readable as CSV: line 2: unexpected end of data"),
        (b'a,b\n"' + b"x" * 200_000 + b"\n", "not readable as CSV: line 2: field larger"),
    ],
)
def test_tables_that_are_none_are_refused_by_line(tmp_path: Path, content: bytes, match: str) -> None:
    with pytest.raises(InputError, match=match):
        read_csv(write(tmp_path, content), ["a", "b"], "poses")


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no poses file .*nowhere\.csv"):
        read_csv(tmp_path / "nowhere.csv", ["a"], "poses")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_csv(tmp_path, ["a"], "poses")


@pytest.mark.parametrize("text", ["", " ", "x", "nan", "inf", "-inf", "1_5", "1e999", "0x10", "\u0661\u0662", "1 2"])
def test_a_cell_that_is_no_plain_number_is_named_by_its_place(text: str) -> None:
    with pytest.raises(InputError, match=r"p\.csv, line 4: x_mm is .*expected a finite number\.$"):
        number(row(text), "x_mm")


@pytest.mark.parametrize("text", ["1,5", "-12,25", "+1,5e3"])
def test_a_decimal_comma_is_named_as_such(text: str) -> None:
    with pytest.raises(InputError, match="expected a finite number; write a decimal point, not a comma"):
        number(row(text), "x_mm")


def test_a_cell_of_endless_digits_is_refused_at_once_and_not_repeated() -> None:
    """Digits that could be read in two ways would take time with their square: here, for hours."""
    with pytest.raises(InputError, match=r"x_mm is '9{60}\.\.\.', expected a finite number"):
        number(row(1_000_000 * "9" + "x"), "x_mm")


def test_plain_numbers_are_read() -> None:
    texts = ["1", " -1.5e1 ", "+.5", "3.", "1E-3", "007"]
    assert [number(row(t), "x_mm") for t in texts] == [1, -15, 0.5, 3, 0.001, 7]


def test_whole_numbers_have_no_fraction() -> None:
    assert whole_number(row("12.0"), "x_mm") == 12
    for text in ("1.5", "1e20"):
        with pytest.raises(InputError, match="expected a whole number"):
            whole_number(row(text), "x_mm")


def test_blank_numbers_are_nan_in_an_array() -> None:
    np.testing.assert_array_equal(numbers([row("1"), row(" ")], ["x_mm"]), [[1], [np.nan]])
    assert numbers([], ["x_mm"]).shape == (0, 1)
