"""What pages of one session and of two share: time line, film, files to keep; plain values for templates."""

import base64
import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.devices import Frame
from ursnav_torch.reports.html import inline_picture
from ursnav_torch.reports.stretches import Stretch
from ursnav_torch.session import Replay

#: Pictures of a film at most, evenly spread; and their width in the page's file, px.
FILM_PICTURES = 36
#: Width of a time line's drawing; its units are of no matter.
WIDTH = 1000.0


def film(replay: Replay, prefix: str) -> list[dict[str, Any]]:
    """Pictures spread evenly over a record: ``id`` on the page, ``t_s`` from the beginning, and ``picture``."""
    times = [e.stamp.t_mono_s for e in replay.events() if isinstance(e, Frame)]
    if not times:
        return []
    kept = set(np.unique(np.linspace(0, len(times) - 1, min(FILM_PICTURES, len(times))).round().astype(int)).tolist())
    frames = (e for e in replay.events() if isinstance(e, Frame))
    return [
        {"id": f"{prefix}{i}", "t_s": times[i] - times[0], "picture": inline_picture(frame.image, 70)}
        for i, frame in enumerate(frames)
        if i in kept
    ]


def time_line(stretches: Sequence[Stretch], film_: Sequence[dict[str, Any]], duration_s: float) -> list[dict[str, Any]]:
    """The stretches as boxes: ``x`` and ``width`` of `WIDTH`, ``kind``, ``words`` and the nearest picture's ``id``."""
    scale = WIDTH / max(duration_s, 0.1)
    boxes = []
    for s in stretches:
        middle = (s.from_s + s.to_s) / 2
        near = min(film_, key=lambda f: abs(f["t_s"] - middle), default=None)
        words = f"{s.from_s:.1f} to {s.to_s:.1f} s: {s.kind}{f', {s.calyx}' if s.calyx else ''}"
        width = max(scale * (s.to_s - s.from_s), 1.0)
        boxes.append({"x": round(scale * s.from_s, 1), "width": round(width, 1), "kind": s.kind, "words": words})
        boxes[-1]["id"] = "" if near is None else near["id"]
    return boxes


def files_to_keep(
    stretches: Sequence[Stretch], calyces: Iterable[dict[str, Any]], replay: Replay
) -> list[dict[str, str]]:
    """The tables behind the page, each a ``name`` and an address that holds it as CSV."""
    rows = [(r.frame, r.row) for r in replay.results() if "state" in r.row]
    columns = ("t_s", "state", "accepted", "calyx", "confidence", *POSE_COLUMNS)
    tables: dict[str, tuple[Sequence[str], Iterable[Sequence[Any]]]] = {
        "moments.csv": (
            ("from_s", "to_s", "kind", "calyx"),
            [(f"{s.from_s:.2f}", f"{s.to_s:.2f}", s.kind, s.calyx) for s in stretches],
        ),
        "calyces.csv": (
            ("calyx", "pole", "verdict", "wall_seen", "time", "visits", "inspected_after"),
            [[c[key] for key in ("name", "pole", "verdict", "share", "time", "visits", "inspected")] for c in calyces],
        ),
        "path.csv": (("frame", *columns), [(n, *(_cell(row.get(c)) for c in columns)) for n, row in rows]),
    }
    return [{"name": name, "address": _csv_address(*table)} for name, table in tables.items()]


def _cell(value: Any) -> Any:
    return str(value).lower() if isinstance(value, bool) else "" if value is None else value


def _csv_address(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return f"data:text/csv;base64,{base64.b64encode(text.getvalue().encode()).decode()}"
