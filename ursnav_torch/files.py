"""Results that are whole or absent: work lies in ``NAME.partial`` and gets its name in one rename; and progress."""

import csv
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from ursnav_torch.errors import InputError

#: ``progress(total, what)`` gives a context with ``advance(n)``: how long work says how far it is.
Progress = Callable[[int, str], AbstractContextManager[Callable[[int], None]]]


@contextmanager
def no_progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """Progress that nobody watches."""
    yield lambda n: None


def partial_path(path: Path) -> Path:
    """Where work in progress on ``path`` lies: beside it, so that the last step is one rename."""
    return path.with_name(path.name + ".partial")


def check_output(path: Path, overwrite: bool) -> None:
    """Refuse to replace a result.

    Raises:
        InputError: ``path`` exists (an empty folder is fine) and ``overwrite`` is false, or its folder is missing
            and cannot be made.
    """
    if path.exists() and not overwrite and not _is_empty_folder(path):
        raise InputError(f"{path} exists already. Choose another out=, or add overwrite=true to replace it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {path.parent} for the result cannot be made: {error.strerror}.") from None


def check_output_file(path: Path, overwrite: bool) -> None:
    """`check_output` for a result that is one file.

    Raises:
        InputError: see `check_output`; also where a folder has that name.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder, but the result is a file; name the file, too.")
    check_output(path, overwrite)


def commit(partial: Path, path: Path) -> None:
    """Give finished work its name; a folder that stood there goes first to ``NAME.old`` and is then removed."""
    if path.is_file() and partial.is_dir():
        path.unlink()
    if path.is_dir() and partial.is_dir():
        old = path.with_name(path.name + ".old")
        shutil.rmtree(old, ignore_errors=True)
        os.rename(path, old)
        os.rename(partial, path)
        shutil.rmtree(old)
    else:
        os.replace(partial, path)


@contextmanager
def whole_file(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a path to write to; it becomes ``path`` only when the block ends without an error."""
    check_output_file(path, overwrite)
    partial = partial_path(path)
    try:
        yield partial
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    commit(partial, path)


def write_json(path: Path, data: Mapping[str, Any], overwrite: bool = True) -> None:
    """Write plain data as indented JSON, whole or not at all."""
    with whole_file(path, overwrite) as partial:
        partial.write_text(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]], overwrite: bool = True) -> None:
    """Write rows as CSV, whole or not at all; absent values are blank, booleans are ``true`` and ``false``."""
    with whole_file(path, overwrite) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: cell(row.get(name)) for name in columns} for row in rows)


def cell(value: Any) -> str:
    """One CSV cell: blank for None and NaN, ``true``/``false``, floats to 6 decimals; NumPy's scalars as Python's."""
    if hasattr(value, "item"):
        value = value.item()
    if value is None or (isinstance(value, float) and value != value):
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts ``view2`` before ``view10``."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in re.split(r"(\d+)", name) if part]


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())
