"""Several sensors in one EM log: the rows of the one on the tip, or a question which it is."""

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.em_log.samples import EmFormat
from ursnav_torch.errors import InputError
from ursnav_torch.tables import Row

Array = NDArray[np.float64]

#: Columns that tell several sensors of one log apart.
_COLUMNS = ("tool", "sensor", "handle", "port", "port_handle", "tool_id", "sensor_id", "device", "marker")
#: What pandas and others call a column that stands twice.
_AGAIN = re.compile(r"(t?[xyz]|[xyz]_[mc]?m)[._]\d+")
#: A log of so many sensors in turns is known by places that far apart from row to row, mm, which no scope moves in a
#: step, and come back after so many rows to within this part of it.
_MOST_SENSORS, _APART_MM, _BACK = 6, 10.0, 0.2
#: Fewer rows tell nothing.
_FEW = 20


def rows_of_one_sensor(rows: list[Row], names: Mapping[str, str], form: EmFormat) -> list[Row]:
    """The rows of the sensor that ``em_tool`` names, where a column tells several apart; ``names`` by small letters.

    Raises:
        InputError: several sensors, and ``em_tool`` names none of them; a second position beside the first.
    """
    if again := [own for name, own in names.items() if _AGAIN.fullmatch(name)]:
        raise InputError(
            f"The EM file {rows[0].path} has several positions in a row ({', '.join(again)}): delete all columns but "
            "those of the sensor on the tip."
        )
    column = next((names[c] for c in _COLUMNS if c in names), None)
    if column is None:
        return rows
    found = sorted({row[column].strip() for row in rows})
    if form.tool is None and len(found) == 1:
        return rows
    if form.tool not in found:
        raise InputError(
            f"The EM file {rows[0].path} has readings of {len(found)} sensor(s) by its column {column} "
            f"({', '.join(found[:8])}); say which is the one on the tip: em_tool=."
        )
    return [row for row in rows if row[column].strip() == form.tool]


def check_one_sensor(position_mm: Array, source: str) -> None:
    """Refuse positions (N, 3), NaN where not visible, that are those of several sensors in turns.

    Raises:
        InputError: they are.
    """
    seen = position_mm[np.isfinite(position_mm).all(axis=1)]
    if len(seen) < _FEW:
        return
    step = float(np.median(np.linalg.norm(np.diff(seen, axis=0), axis=1)))
    if step < _APART_MM:
        return
    for n in range(2, _MOST_SENSORS + 1):
        if float(np.median(np.linalg.norm(seen[n:] - seen[:-n], axis=1))) < _BACK * step:
            raise InputError(
                f"The positions of {source} lie {step:.0f} mm apart from row to row, and are the same again after {n} "
                f"rows: {n} sensors in one log? Give the rows of the one on the tip, or a column tool and em_tool=."
            )
