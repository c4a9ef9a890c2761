"""EM samples from a file, played at their own times."""

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.devices.base import EmTracker, SourceAtEndError, TrackerSample, Vector3
from ursnav_torch.em_log import EmFormat, check_clock, read_em_samples
from ursnav_torch.errors import DeviceTimeoutError, InputError


class CsvTracker(EmTracker):
    """Plays ``frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz``; see `read_em_samples` for what is read besides.

    Args:
        path: the file; without ``t_s`` its rows come at ``rate_hz``.
        speed: 1 for real time, larger for faster, 0 for as fast as it is read.
        rate_hz: rows a second where the file has no times.
        em_unit: of its lengths, where it does not say it, see `EmFormat`.

    Raises:
        InputError: the file cannot be used; its times must not run backwards or stand still.
    """

    def __init__(self, path: str | Path, speed: float = 1.0, rate_hz: float = 40.0, em_unit: str | None = None) -> None:
        super().__init__()
        if speed < 0 or rate_hz <= 0:
            raise InputError(f"speed must be 0 or more and rate_hz positive, got {speed} and {rate_hz}.")
        self.path, self.speed = Path(path), speed
        samples = read_em_samples(self.path, EmFormat(em_unit))
        times = np.arange(len(samples.position_mm)) / rate_hz if samples.t_s is None else samples.t_s
        if not np.isfinite(times).all():
            raise InputError(f"{self.path}: t_s is blank in data row {int(np.isnan(times).argmax()) + 1}; fill it.")
        if np.any(np.diff(times) < 0):
            raise InputError(f"{self.path}: the column t_s runs backwards; sort the rows by time.")
        check_clock(samples)
        if np.isnan(samples.axis[samples.seen]).any():
            raise InputError(f"{self.path}: the axis dx,dy,dz is missing or zero in rows where the sensor was visible.")
        self._times: list[float] = times.tolist()
        self._poses = [
            (_vector(p), _vector(a)) if seen else None
            for p, a, seen in zip(samples.position_mm, samples.axis, samples.seen, strict=True)
        ]
        self._next, self._start_s = 0, 0.0

    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the next row's time; raises as `EmTracker.read` does."""
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


def _vector(values: NDArray[np.float64]) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z
