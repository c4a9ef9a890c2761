"""What an interrupted `match` run had finished: one JSON line a picture, beside the result."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


class Journal:
    """Lines of finished work; the first says of what work.

    Args:
        path: the file; a journal of the very same work is taken up, any other is replaced.
        work: plain data that changes when the work does.
    """

    def __init__(self, path: Path, work: Mapping[str, Any]) -> None:
        self.path = path
        self.done: list[dict[str, Any]] = _read(path, work)
        lines = [work, *self.done]
        path.write_text("".join(_line(line) for line in lines), encoding="utf-8")

    def add(self, entry: Mapping[str, Any]) -> None:
        """Append one finished item."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(_line(entry))


def _read(path: Path, work: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of a journal of this work; a last line that was cut short is dropped."""
    entries: list[dict[str, Any]] = []
    try:
        lines: Sequence[str] = path.read_text(encoding="utf-8").splitlines()
        for line in lines:
            entries.append(json.loads(line))
    except (OSError, ValueError):
        pass
    return entries[1:] if entries and entries[0] == json.loads(_line(work)) else []


def _line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry, ensure_ascii=False) + "\n"
