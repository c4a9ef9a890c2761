"""Results that are whole or absent: work lies in ``NAME.partial`` and gets its name in one rename; and progress."""

import csv
import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from ursnav_torch.disk import disk_errors
from ursnav_torch.errors import InputError
from ursnav_torch.locks import locked, partial_path

#: ``progress(total, what)`` gives a context with ``advance(n)``: how long work says how far it is.
Progress = Callable[[int, str], AbstractContextManager[Callable[[int], None]]]


@contextmanager
def no_progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """Progress that nobody watches."""
    yield lambda n: None


def check_output(path: Path, overwrite: bool) -> None:
    """Refuse to replace a result, or to write where nothing can be written.

    Raises:
        InputError: ``path`` exists (an empty folder is fine) and ``overwrite`` is false, or its folder is missing
            and cannot be made, or cannot be written to.
    """
    if path.exists() and not overwrite and not _is_empty_folder(path):
        raise InputError(f"{path} exists already. Choose another out=, or add overwrite=true to replace it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"The folder {path.parent} for the result cannot be made: {error.strerror}.") from None
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(
            f"The folder {path.parent} for the result cannot be written to: it is read-only or another user's. "
            "Choose another out=."
        )


def check_output_file(path: Path, overwrite: bool) -> None:
    """`check_output` for a result that is one file.

    Raises:
        InputError: see `check_output`; also where a folder has that name.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder, but the result is a file; name the file, too.")
    check_output(path, overwrite)


def commit(partial: Path, path: Path) -> None:
    """Give finished work its name; a folder that stood there is first moved aside and then removed."""
    if path.is_file() and partial.is_dir():
        path.unlink()
    if path.is_dir() and partial.is_dir():
        remove_aside(path)
        os.rename(path, _aside(path))
        os.rename(partial, path)
    else:
        os.replace(partial, path)
    remove_aside(path)


def remove_aside(path: Path) -> None:
    """Remove the former folder ``path`` that `commit` moved aside, perhaps in a process that was then killed."""
    shutil.rmtree(_aside(path), ignore_errors=True)


def _aside(path: Path) -> Path:
    return path.with_name(path.name + ".partial.old")


@contextmanager
def whole_file(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a path to write to; it becomes ``path`` only when the block ends without an error.

    Raises:
        InputError: see `check_output_file`; another process writes it; the disk is full or read-only.
    """
    check_output_file(path, overwrite)
    with disk_errors(path), locked(path):
        check_output_file(path, overwrite)
        partial = partial_path(path)
        try:
            yield partial
            commit(partial, path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise


@contextmanager
def whole_folder(path: Path, overwrite: bool = False, resume: bool = False) -> Iterator[Path]:
    """Yield a folder to write to; it becomes ``path`` only when the block ends without an error.

    Args:
        path: the folder to be made.
        overwrite: replace what stands there.
        resume: keep what an interrupted run left in the work folder, and leave it there after an error. Else it is
            empty at first, and removed after an error.

    Raises:
        InputError: see `check_output`; another process writes it; the disk is full or read-only.
    """
    check_output(path, overwrite)
    with disk_errors(path), locked(path):
        check_output(path, overwrite)
        work = partial_path(path)
        if not resume:
            shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True, exist_ok=True)
        try:
            yield work
            commit(work, path)
        except BaseException:
            if not resume:
                shutil.rmtree(work, ignore_errors=True)
            raise


def write_image(path: Path, image: Any, jpeg_quality: int | None = None) -> None:
    """Write a picture, uint8 (H, W) or (H, W, 3) in OpenCV's order, in the format that the name's ending says.

    OpenCV's own `imwrite` says nothing when the disk is full.

    Raises:
        OSError: it cannot be written.
    """
    import cv2

    options = [] if jpeg_quality is None else [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    path.write_bytes(cv2.imencode(path.suffix, image, options)[1].tobytes())


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


def fingerprint(path: Path) -> tuple[int, str]:
    """Size in bytes and sha256 of a file; -1 and blank where it cannot be read."""
    try:
        with path.open("rb") as file:
            return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return -1, ""


def is_file(path: Path) -> bool:
    """Whether a name that comes from outside is a file; False, too, for one that no file can have (too long)."""
    try:
        return path.is_file()
    except OSError:
        return False


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts ``view2`` before ``view10``."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in re.split(r"(\d+)", name) if part]


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())
