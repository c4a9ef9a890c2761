"""Plain data of JSON files as records with types, and JSON that cannot break the program that reads it."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ursnav_torch.errors import InputError

T = TypeVar("T")


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
        raise InputError(f"{where} cannot be used: {error}.") from error


def read_json(path: Path, what: str) -> Any:
    """The plain data of a JSON file.

    Raises:
        InputError: missing, not text, not JSON (which knows neither NaN nor infinity) or nested without end;
            ``what`` names the kind of file.
    """
    try:
        return msgspec.json.decode(Path(path).read_bytes().removeprefix(b"\xef\xbb\xbf"))
    except FileNotFoundError:
        raise InputError(f"There is no {what} file {path}.") from None
    except OSError as error:
        raise InputError(f"The {what} file {path} cannot be read: {error.strerror}.") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"The {what} file {path} is not readable JSON: {error}.") from None
