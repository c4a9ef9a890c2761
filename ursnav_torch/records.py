"""Plain data of JSON files as records with types, and JSON that cannot break the program that reads it."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ursnav_torch.errors import InputError
from ursnav_torch.inputs import MOST_TEXT_BYTES, read_regular

T = TypeVar("T")

#: Levels of lists and objects in each other; Slicer's markups, the deepest files that are read, have 6.
DEEPEST = 32


def to_record(data: Any, kind: type[T], where: str, only_known: bool = False) -> T:
    """Plain data as a dataclass, a container or a plain type, every field checked by its annotation.

    Args:
        data: what a JSON reader gives.
        kind: what it shall be.
        where: what holds it, the first words of an error's sentence.
        only_known: refuse keys that a dataclass has no field for, which are passed over otherwise.

    Raises:
        InputError: a field is missing or of another kind, or the record refuses its value.
    """
    if only_known and isinstance(data, Mapping):
        fields = [f.name for f in dataclasses.fields(kind)]  # type: ignore[arg-type]
        unknown = [str(key) for key in data if key not in fields]
        if unknown:
            raise InputError(f"{where} cannot hold {', '.join(unknown)}; known are {', '.join(fields)}.")
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{where} cannot be used: {str(error).rstrip('.')}.") from error


def read_json(path: Path, what: str) -> Any:
    """The plain data of a JSON file.

    Raises:
        InputError: missing, no regular file, too large, not text, not JSON (which knows neither NaN nor infinity) or
            nested deeper than `DEEPEST`; ``what`` names the kind of file.
    """
    text = read_regular(path, f"{what} file", MOST_TEXT_BYTES)
    return parse_json(text, f"The {what} file {path}")


def parse_json(text: bytes, where: str) -> Any:
    """The plain data of JSON text, UTF-8.

    Raises:
        InputError: as `read_json` does; ``where`` begins its sentence.
    """
    try:
        data = msgspec.json.decode(text.removeprefix(b"\xef\xbb\xbf"))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{where} is not readable JSON: {error}.") from None
    level = [data]
    for _ in range(DEEPEST):
        level = [inner for item in level if isinstance(item, (dict, list)) for inner in _inside(item)]
        if not level:
            return data
    raise InputError(f"{where} is not readable JSON: it is nested more than {DEEPEST} deep, which nothing here is.")


def _inside(item: dict[str, Any] | list[Any]) -> Any:
    return item.values() if isinstance(item, dict) else item
