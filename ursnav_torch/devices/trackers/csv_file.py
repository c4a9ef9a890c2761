"""EM samples from a file, played at their own times."""

import time
from pathlib import Path

from ursnav_torch.columns import EM_COLUMNS
from ursnav_torch.devices.base import SourceAtEndError, Tracker, TrackerSample, Vector3
from ursnav_torch.errors import DeviceTimeoutError, InputError
from ursnav_torch.tables import Row, number, read_csv


class CsvTracker(Tracker):
    """Plays ``frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz``; blank numbers are a sensor that was not seen.

    Args:
        path: the file; without ``t_s`` its rows come at ``rate_hz``.
        speed: 1 for real time, larger for faster, 0 for as fast as it is read.
        rate_hz: rows a second where the file has no times.

    Raises:
        InputError: the file cannot be used; its times must not run backwards.
    """

    def __init__(self, path: str | Path, speed: float = 1.0, rate_hz: float = 40.0) -> None:
        super().__init__()
        if speed < 0 or rate_hz <= 0:
            raise InputError(f"speed must be 0 or more and rate_hz positive, got {speed} and {rate_hz}.")
        self.path, self.speed = Path(path), speed
        rows = read_csv(self.path, EM_COLUMNS, "EM")
        timed = "t_s" in rows[0]
        self._times = [number(r, "t_s") if timed else n / rate_hz for n, r in enumerate(rows)]
        if any(b < a for a, b in zip(self._times[:-1], self._times[1:], strict=True)):
            raise InputError(f"{self.path}: the column t_s runs backwards; sort the rows by time.")
        self._poses = [_pose(row) for row in rows]
        self._next, self._start_s = 0, 0.0

    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the next row's time; raises as `Tracker.read` does."""
        self._check_connected()
        if self._next >= len(self._poses):
            raise SourceAtEndError(f"{self.path} is at its end after {len(self._poses)} samples.")
        if self.speed:
            due = self._start_s + (self._times[self._next] - self._times[0]) / self.speed
            wait = due - time.monotonic()
            time.sleep(max(0.0, min(wait, timeout_s)))
            if wait > timeout_s:
                raise DeviceTimeoutError(f"The next sample of {self.path} is not due within {timeout_s} s.")
        pose, n = self._poses[self._next], self._next
        self._next += 1
        if pose is None:
            return TrackerSample(self._stamp(), False, source_frame=n)
        return TrackerSample(self._stamp(), True, *pose, source_frame=n)

    def _open(self) -> None:
        self._next, self._start_s = 0, time.monotonic()

    def _close(self) -> None: ...


def _pose(row: Row) -> tuple[Vector3, Vector3] | None:
    """Position and axis of a row, None where all of them are blank."""
    if not any(row[c].strip() for c in EM_COLUMNS):
        return None
    x, y, z, *axis = (number(row, c) for c in EM_COLUMNS)
    length = sum(v * v for v in axis) ** 0.5
    if length < 1e-6:
        raise InputError(f"{row.path}, line {row.line}: the axis dx,dy,dz is zero.")
    return (x, y, z), (axis[0] / length, axis[1] / length, axis[2] / length)
