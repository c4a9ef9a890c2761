"""EM logs as trackers and their programs write them: units and clocks are recognized or asked for."""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import EM_COLUMNS
from ursnav_torch.em_log.lengths import check_lengths
from ursnav_torch.em_log.samples import TIME_S, EmFormat, EmSamples
from ursnav_torch.em_log.seen import NO_NUMBER, NO_READING, flagged_seen, in_field, no_place
from ursnav_torch.em_log.sensors import check_one_sensor, rows_of_one_sensor
from ursnav_torch.em_log.sequence import SEQUENCE_SUFFIXES, read_sequence
from ursnav_torch.errors import InputError
from ursnav_torch.tables import Row, number, read_csv
from ursnav_torch.units import LENGTH_MM

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: A quaternion may be so much longer or shorter than 1, by rounding.
_LONGER = 0.02
#: Axes may be so much longer than others, by rounding to a digit.
_UNEVEN = 0.25
#: A whole number as some programs write it, 12.0.
_WHOLE = re.compile(r"^(\d+)\.0+$", re.ASCII)
#: Words for an orientation by three angles.
_ANGLES = ("rx", "ry", "rz", "azimuth", "elevation", "roll", "pitch", "yaw", "a", "b", "c", "alpha", "beta", "gamma")
#: So many readings that are the same to the last digit are said.
_REPEATS = 10


def read_em_samples(path: str | Path, form: EmFormat | None = None) -> EmSamples:
    """Read ``frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz`` (or ``image`` for ``frame``); all but the position may be missing.

    Read besides: ``x_cm``, ``x_m``, ``x_in``, ``t_ms``, ``t_us``, ``t_ns``; ``Tx,Ty,Tz`` (NDI, mm); ``qx,qy,qz,qw``
    (or NDI's ``Q0,Qx,Qy,Qz``), whose z axis is the sensor's; columns such as ``state`` or ``visible``. Blank cells,
    NaN, numbers beyond any field (-3.697314E28), zeros in position and axis and flags that say so are a sensor that was
    not visible. Sequences that Plus recorded (.mha, .mhd) are read, too, see `read_sequence`.

    Raises:
        InputError: it cannot be read, has no position or row, says nothing of its unit, or says what cannot be.
    """
    form = form or EmFormat()
    if Path(path).suffix.lower() in SEQUENCE_SUFFIXES:
        return read_sequence(Path(path), form)
    rows = read_csv(path, (), "EM")
    names = _names(rows[0], Path(path))
    rows = rows_of_one_sensor(rows, names, form)
    at, unit = _length_columns(names, Path(path), form)
    position = _numbers(rows, at) * unit
    seen = flagged_seen(rows, names) & in_field(position, rows) & ~no_place(position)
    quaternion = _quaternions(rows, names, seen)
    axis = _axes(rows, names, seen, quaternion)
    _check_repeats(position, seen, rows)
    position[~seen] = axis[~seen] = np.nan
    if quaternion is not None:
        quaternion[~seen] = np.nan
    t_s = _times(rows, names, form)
    check_lengths(position, t_s, str(path), form)
    check_one_sensor(position, str(path))
    key = next((name for name in ("image", "frame") if name in names), None)
    return EmSamples(
        position_mm=position,
        axis=axis,
        t_s=t_s,
        key=tuple(_WHOLE.sub(r"\1", row[names[key]].strip()) for row in rows) if key else None,
        key_column=key,
        quaternion=quaternion,
        source=str(path),
        line=np.array([row.line for row in rows]),
    )


def _names(row: Row, path: Path) -> dict[str, str]:
    """Columns by what they are called here: small letters, ``x [mm]`` and ``x(mm)`` as x_mm, ``Time [s]`` as t_s."""
    found: dict[str, str] = {}
    for name in row:
        plain = re.sub(r"^(\w+?)\s*[\[(]\s*(\w+)\s*[\])]$", r"\1_\2", name.lower().replace("µ", "u").replace("μ", "u"))
        plain = re.sub(r"^(time|timestamp)_", "t_", plain)
        if plain in found:
            raise InputError(f"The EM file {path} has the columns {found[plain]} and {name} for one thing; delete one.")
        found[plain] = name
    return found


def _length_columns(names: Mapping[str, str], path: Path, form: EmFormat) -> tuple[list[str], float]:
    """The position's columns and mm a unit of theirs."""
    for unit, mm in LENGTH_MM.items():
        if all(f"{c}_{unit}" in names for c in "xyz"):
            return [names[f"{c}_{unit}"] for c in "xyz"], LENGTH_MM[form.unit] if form.unit else mm
    for columns, known in ((("tx", "ty", "tz"), "mm"), (("x", "y", "z"), None)):
        if all(c in names for c in columns):
            unit_ = form.unit or known
            if unit_ is None:
                raise InputError(
                    f"The EM file {path} has the columns x,y,z and does not say their unit: set em_unit= to one of "
                    f"{', '.join(LENGTH_MM)}, or name them x_mm,y_mm,z_mm."
                )
            return [names[c] for c in columns], LENGTH_MM[unit_]
    missing = [c for c in EM_COLUMNS[:3] if c not in names]
    raise InputError(
        f"The EM file {path} lacks the column(s) {', '.join(missing)}; it has {', '.join(names.values())}."
    )


def _cell(row: Row, column: str) -> float:
    return np.nan if row[column].strip().lower() in NO_READING else number(row, column)


def _numbers(rows: list[Row], columns: list[str]) -> Array:
    """(N, C) values; NaN where a cell is blank or no number that a tracker means."""
    values = np.array([[_cell(row, c) for c in columns] for row in rows], float)
    return np.where(np.abs(values) < NO_NUMBER, values, np.nan)


def _quaternions(rows: list[Row], names: Mapping[str, str], seen: BoolArray) -> Array | None:
    """(N, 4) of unit length; what rows that are not seen (N,) hold instead is not checked."""
    for order in (("qx", "qy", "qz", "qw"), ("qx", "qy", "qz", "q0")):
        if all(c in names for c in order):
            q = _numbers(rows, [names[c] for c in order])
            length = np.linalg.norm(q, axis=1, keepdims=True)
            there = length > 1e-9
            if (off := seen[:, None] & there & (np.abs(length - 1) > _LONGER)).any():
                row = rows[int(off.argmax())]
                raise InputError(
                    f"{row.path}, line {row.line}: the quaternion has the length {length[off][0]:.4g}, expected 1: are "
                    "these other numbers, such as angles? Rename the columns then."
                )
            return np.asarray(q / np.where(there, length, np.nan))
    return None


def _axes(rows: list[Row], names: Mapping[str, str], seen: BoolArray, quaternion: Array | None) -> Array:
    if all(c in names for c in EM_COLUMNS[3:]):
        axis = _numbers(rows, [names[c] for c in EM_COLUMNS[3:]])
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        _check_one_length(length[seen[:, None] & (length > 1e-9)], rows)
        return np.asarray(axis / np.where(length > 1e-9, length, np.nan))
    if quaternion is None:
        if unread := [names[c] for c in _ANGLES if c in names]:
            warnings.warn(
                f"{rows[0].path}: the columns {', '.join(unread)} are not read, since trackers turn about their axes "
                "in different orders. Where the sensor points is unknown; write dx,dy,dz or qx,qy,qz,qw if needed.",
                stacklevel=3,
            )
        return np.full((len(rows), 3), np.nan)
    x, y, z, w = quaternion.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _check_one_length(length: Array, rows: list[Row]) -> None:
    """Refuse axes of many lengths (N,): they are other numbers, such as angles or differences."""
    if len(length) >= _REPEATS and (length.max() > (1 + _UNEVEN) * length.min()):
        raise InputError(
            f"{rows[0].path}: dx, dy, dz are {length.min():.3g} to {length.max():.3g} long; a sensor's axis has one "
            "length. Are they angles, or steps? Rename the columns if they are not the direction that it points in."
        )


def _times(rows: list[Row], names: Mapping[str, str], form: EmFormat) -> Array | None:
    for unit, seconds in TIME_S.items():
        if (column := names.get(f"t_{unit}")) is not None:
            return _clock(rows, column, TIME_S[form.time_unit] if form.time_unit else seconds) - form.offset_s
    column = next((names[c] for c in ("t", "time", "timestamp") if c in names), None)
    if column is None:
        return None
    _clock(rows, column, 1.0)  # a time of day is told as what it is
    if form.time_unit is None:
        raise InputError(
            f"{rows[0].path} has a column {column} and does not say its unit: set em_time_unit= to one of "
            f"{', '.join(TIME_S)}, or name it t_s."
        )
    return _clock(rows, column, TIME_S[form.time_unit]) - form.offset_s


def _clock(rows: list[Row], column: str, seconds: float) -> Array:
    t = np.array([_cell(row, column) for row in rows]) * seconds
    if not np.isfinite(t).any():
        raise InputError(f"{rows[0].path}: the column {column} is blank in all {len(rows)} rows; delete or fill it.")
    return t


def _check_repeats(position: Array, seen: BoolArray, rows: list[Row]) -> None:
    """Say where a reading stays the same to the last digit, which no sensor does that is seen."""
    changes = np.flatnonzero(np.any(np.diff(position, axis=0) != 0, axis=1) | ~seen[1:]) + 1
    ends = np.concatenate([[0], changes, [len(position)]])
    longest = int(np.diff(ends).argmax())
    first, last = int(ends[longest]), int(ends[longest + 1]) - 1
    if int(seen.sum()) == last - first + 1 >= _REPEATS and seen[first]:
        raise InputError(
            f"All {int(seen.sum())} readings of {rows[0].path} are the same to the last digit: the tracker repeated "
            "its first one, and nothing was measured. Record again with the sensor in the field."
        )
    if _REPEATS <= last - first + 1 and seen[first]:
        warnings.warn(
            f"{rows[0].path}, lines {rows[first].line} to {rows[last].line}: {last - first + 1} readings are the same "
            "to the last digit. Does the tracker repeat its last one while it sees nothing? Blank their cells then.",
            stacklevel=3,
        )
