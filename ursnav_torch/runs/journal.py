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
        images: the pictures in their order; entries count as far as they are rows of these.
    """

    def __init__(self, path: Path, work: Mapping[str, Any], images: Sequence[str]) -> None:
        self.path = path
        self.done: list[dict[str, Any]] = _read(path, work, images)
        lines = [work, *self.done]
        path.write_text("".join(_line(line) for line in lines), encoding="utf-8")

    def add(self, entry: Mapping[str, Any]) -> None:
        """Append one finished item."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(_line(entry))


def _read(path: Path, work: Mapping[str, Any], images: Sequence[str]) -> list[dict[str, Any]]:
    """Entries of a journal of this work, up to a line that was cut short or is another picture's."""
    entries: list[dict[str, Any]] = []
    try:
        lines: Sequence[str] = path.read_text(encoding="utf-8").splitlines()
        if not lines or json.loads(lines[0]) != json.loads(_line(work)):
            return []
        for image, line in zip(images, lines[1:], strict=False):
            entry = json.loads(line)
            if entry["row"]["image"] != image or "page" not in entry:
                break
            entries.append(entry)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    return entries


def _line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry, ensure_ascii=False) + "\n"
