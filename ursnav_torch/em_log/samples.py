"""Readings of an EM sensor, and what a log does not say about itself."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.units import LENGTH_MM

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: s a unit of time: what stands behind ``t_`` in column names. Ticks are .NET's.
TIME_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ticks": 1e-7, "min": 60.0}


@dataclass(frozen=True, slots=True)
class EmFormat:
    """What a log does not say about itself; None takes the column names' word, and asks where there is none.

    Args:
        unit: of positions: mm, cm, m, in.
        time_unit: of times: s, ms, us, ns, ticks (of 100 ns), min.
        offset_s: the log's clock when the pictures' shows zero; it is taken off.
        join: ``frame`` where frame numbers are the pictures', ``time`` where they are the tracker's own.
        tool: the sensor's name where a log has several: of its transform in a sequence of Plus, or in a column tool.

    Raises:
        InputError: a word that is none of these.
    """

    unit: str | None = None
    time_unit: str | None = None
    offset_s: float = 0.0
    join: str | None = None
    tool: str | None = None

    def __post_init__(self) -> None:
        for name, value, known in (
            ("em_unit", self.unit, tuple(LENGTH_MM)),
            ("em_time_unit", self.time_unit, tuple(TIME_S)),
            ("em_join", self.join, ("frame", "time")),
        ):
            if value is not None and value not in known:
                raise InputError(f"{name} is {value!r}; accepted are {', '.join(known)}, and null.")
        if not np.isfinite(self.offset_s):
            raise InputError(f"em_offset_s is {self.offset_s}; expected seconds.")


@dataclass(frozen=True, slots=True, eq=False)
class EmSamples:
    """Readings of a sensor in the EM frame; rows where it was not visible are NaN.

    Attributes:
        position_mm: (N, 3).
        axis: (N, 3) unit vectors along the sensor, forward; NaN where the file has none.
        t_s: (N,) time, NaN where blank; None: there is no such column.
        key: N names of the frames or images that the readings belong to, or None.
        key_column: ``image`` or ``frame``, whichever ``key`` comes from.
        quaternion: (N, 4) x, y, z, w of a sensor with six degrees of freedom, NaN where not visible, or None.
        source: the file, for people to read.
        line: (N,) where in the file each stands, for people to read; None where it has no lines of its own.
    """

    position_mm: Array
    axis: Array
    t_s: Array | None = None
    key: tuple[str, ...] | None = None
    key_column: str | None = None
    quaternion: Array | None = None
    source: str = "the EM log"
    line: NDArray[np.int64] | None = None

    @property
    def seen(self) -> BoolArray:
        """(N,) where the sensor was visible."""
        return np.asarray(np.isfinite(self.position_mm).all(axis=1))

    def stretch(self, first: int, last: int) -> str:
        """Where rows ``first`` to ``last`` stand: their lines in the file, or their numbers from 1 on."""
        if self.line is None:
            return f"its readings {first + 1} to {last + 1}"
        return f"its lines {self.line[first]} to {self.line[last]}"

    def visible(self) -> "EmSamples":
        """Only the rows where the sensor was visible."""
        return self.rows(np.flatnonzero(self.seen))

    def rows(self, rows: NDArray[np.int64]) -> "EmSamples":
        """Some rows, copied; -1 gives one that is not visible."""
        there = rows >= 0

        def taken(values: Array) -> Array:
            return np.where(there[:, None], values[rows], np.nan)

        return replace(
            self,
            position_mm=taken(self.position_mm),
            axis=taken(self.axis),
            t_s=None if self.t_s is None else np.where(there, self.t_s[rows], np.nan),
            key=None if self.key is None else tuple(self.key[i] if i >= 0 else "" for i in rows),
            quaternion=None if self.quaternion is None else taken(self.quaternion),
            line=None if self.line is None else np.where(there, self.line[rows], 0),
        )
