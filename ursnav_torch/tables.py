"""Reading CSV, in one strict way: cells are counted, headers unique, numbers plain, and errors name the line."""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.inputs import MOST_TEXT_BYTES, read_regular

Array = NDArray[np.float64]

#: What counts as a number: ASCII digits with a decimal point; Python's own float() takes ``1_5`` and ``١٢`` besides.
# One way to read each digit alone: where there are two, a cell of ten thousand digits takes seconds to be refused.
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?", re.ASCII)
#: Characters of a wrong cell that an error's sentence repeats.
_MOST_SAID = 60


class Row(dict[str, str]):
    """The cells of one line by column name, blank ones as ``""``, and where they stand: ``path`` and ``line``."""

    def __init__(self, cells: Mapping[str, str], path: Path, line: int) -> None:
        super().__init__(cells)
        self.path, self.line = path, line


def read_csv(path: str | Path, required: Sequence[str], what: str) -> list[Row]:
    """The rows of a CSV file (UTF-8, commas between cells, a header line) with at least the ``required`` columns.

    Blank lines are passed over, and so are blank cells without a column and lines of commas at the end.

    Raises:
        InputError: missing, not text, without rows or a required column; a column name that stands twice; a row with
            more or fewer cells than the header. ``what`` names the kind of file.
    """
    path = Path(path)
    lines = _lines(path, what)
    _, header = next(lines, (0, []))
    names = _columns(header, path, required, what)
    rows = [Row(_cells(names, cells, path, line), path, line) for line, cells in lines]
    if not rows:
        raise InputError(f"The {what} file {path} has no rows{_expected(required)}.")
    return rows


def check_columns(names: Iterable[str], required: Sequence[str], path: str | Path, what: str) -> None:
    """Refuse a header that lacks columns.

    Raises:
        InputError: it does; ``what`` names the kind of file.
    """
    there = list(names)
    if missing := [name for name in required if name not in there]:
        raise InputError(f"The {what} file {path} lacks the column(s) {', '.join(missing)}; it has {', '.join(there)}.")


def number(row: Row, column: str) -> float:
    """A finite number from a cell.

    Raises:
        InputError: blank, not a number in plain decimals, or not finite; the message names file, line and column.
    """
    text = row[column].strip()
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    if math.isfinite(value):
        return value
    hint = "; write a decimal point, not a comma" if _DECIMAL_COMMA.fullmatch(text) else ""
    said = row[column] if len(row[column]) <= _MOST_SAID else f"{row[column][:_MOST_SAID]}..."
    raise InputError(f"{row.path}, line {row.line}: {column} is {said!r}, expected a finite number{hint}.")


def whole_number(row: Row, column: str) -> int:
    """A whole number from a cell.

    Raises:
        InputError: as `number` does, and where it has a fraction or more than 15 digits.
    """
    value = number(row, column)
    if value != round(value) or abs(value) >= 1e15:
        raise InputError(f"{row.path}, line {row.line}: {column} is {row[column]!r}, expected a whole number.")
    return int(value)


def numbers(rows: Sequence[Row], columns: Sequence[str]) -> Array:
    """(N, C) numbers of some columns; a blank cell is NaN.

    Raises:
        InputError: as `number` does, for the first cell that is neither.
    """
    values = [[number(row, name) if row[name].strip() else math.nan for name in columns] for row in rows]
    return np.array(values, float).reshape(len(rows), len(columns))


def _lines(path: Path, what: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of every line; of those without any word, only the ones with commas and others behind them."""
    blank: list[tuple[int, list[str]]] = []
    text = read_regular(path, f"{what} file", MOST_TEXT_BYTES)
    try:
        file = io.StringIO(text.decode("utf-8-sig"), newline="")
        reader, line, begun = csv.reader(file, skipinitialspace=True, strict=True), 1, False
        for cells in reader:
            if not begun and len(cells) == 1 and cells[0].startswith("#"):  # a remark before the header
                _check_remark(cells[0], path)
                line = reader.line_num + 1
                continue
            begun = begun or any(cells)
            if any(cell.strip() for cell in cells):
                yield from blank
                yield line, cells
                blank = []
            elif len(cells) > 1:
                blank.append((line, cells))
            line = reader.line_num + 1
    except UnicodeDecodeError:
        raise InputError(
            f"The {what} file {path} is not readable as CSV: it is no text in UTF-8. Save it as 'CSV UTF-8'."
        ) from None
    except csv.Error as error:
        raise InputError(f"The {what} file {path} is not readable as CSV: line {line}: {error}.") from None


def _check_remark(text: str, path: Path) -> None:
    if text.startswith("# Markups fiducial"):
        raise InputError(f"{path} is a point list of an old 3D Slicer (.fcsv); save it as .mrk.json and give that.")


def _columns(header: list[str], path: Path, required: Sequence[str], what: str) -> list[str]:
    names = [name.strip() for name in header]
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise InputError(f"The {what} file {path} has the column(s) {', '.join(twice)} twice; each may stand once.")
    if not names:
        raise InputError(f"The {what} file {path} has no rows{_expected(required)}.")
    missing = [name for name in required if name not in names]
    alone = len(names) == 1 and not required
    if not missing and not alone:
        return names
    other = next((sign for sign in ";\t" if sign in names[0] or (len(names) == 1 and sign in header[0])), None)
    if other or (alone and " " in names[0]):
        word = {";": "semicolons", "\t": "tabs", None: "blanks"}[other]
        raise InputError(
            f"The {what} file {path} has {word} between its cells; save it with commas between cells and with points "
            f"in numbers{_expected(required)}."
        )
    check_columns(names, required, path, what)
    return names


def _expected(required: Sequence[str]) -> str:
    return f"; expected the columns {','.join(required)}" if required else ""


def _cells(names: list[str], cells: list[str], path: Path, line: int) -> dict[str, str]:
    surplus = [cell for cell in cells[len(names) :] if cell.strip()]
    if surplus or len(cells) < len(names):
        hint = "are there decimal commas?" if surplus else "was the file cut off, or a comma left out?"
        raise InputError(f"{path}, line {line} has {len(cells)} cells, the header {len(names)}; {hint}")
    unnamed = [cell for name, cell in zip(names, cells, strict=False) if not name and cell.strip()]
    if unnamed:
        raise InputError(f"{path}, line {line}: the cell {unnamed[0]!r} stands in a column without a name.")
    return {name: cell for name, cell in zip(names, cells, strict=False) if name}
