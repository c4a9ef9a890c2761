"""CSV files of registration: landmarks and EM samples."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array
from ursnav_torch.tables import numbers, read_csv

_LANDMARK = ("kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
_POSITION = ("x_mm", "y_mm", "z_mm")
_AXIS = ("dx", "dy", "dz")


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Pairs of points.

    Attributes:
        em_mm, kidney_mm: (N, 3) in the two frames.
        em_axis: (N, 3) the sensor's axis at each touch, or None.
    """

    em_mm: Array
    kidney_mm: Array
    em_axis: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EmSamples:
    """Readings of a 5-DoF sensor in the EM frame; rows where the sensor was not visible are NaN.

    Attributes:
        position_mm: (N, 3).
        axis: (N, 3) unit vectors along the sensor, forward; NaN where the file has none.
        t_s: (N,) time, or None.
        key: N names of the frames or images that the readings belong to, or None.
    """

    position_mm: Array
    axis: Array
    t_s: Array | None = None
    key: tuple[str, ...] | None = None

    def visible(self) -> "EmSamples":
        """Only the rows with a finite position."""
        keep = np.isfinite(self.position_mm).all(axis=1)
        return self._rows(np.flatnonzero(keep))

    def for_images(self, images: Sequence[str], t_s: ArrayLike | None = None, within_s: float = 0.25) -> "EmSamples":
        """One reading an image, NaN where there is none.

        Joined by name (the image's file name, or its number as ``00012.png`` for frame 12), else by the nearest time.

        Args:
            images: names of the images.
            t_s: (M,) their times, where known.
            within_s: largest difference in time.

        Raises:
            InputError: no image has a reading.
        """
        rows = join_names(self.key or (), images)
        if np.all(rows < 0) and t_s is not None and self.t_s is not None:
            rows = self._by_time(np.asarray(t_s, float), within_s)
        if np.all(rows < 0):
            raise InputError(
                f"No EM reading belongs to any of the {len(images)} images (first image {images[:1]}, first reading "
                f"{self.key[:1] if self.key else None}). Give the EM file a column image or frame that names them, "
                "or t_s in both files."
            )
        samples = self._rows(np.maximum(rows, 0))
        samples.position_mm[rows < 0] = np.nan
        samples.axis[rows < 0] = np.nan
        return samples

    def _rows(self, rows: NDArray[np.int64]) -> "EmSamples":
        t = None if self.t_s is None else self.t_s[rows]
        key = None if self.key is None else tuple(self.key[i] for i in rows)
        return EmSamples(self.position_mm[rows].copy(), self.axis[rows].copy(), t, key)

    def _by_time(self, t_s: Array, within_s: float) -> NDArray[np.int64]:
        assert self.t_s is not None
        times = np.where(np.isfinite(self.t_s), self.t_s, np.inf)
        gap = np.abs(times[None] - t_s[:, None])
        nearest = gap.argmin(axis=1)
        return np.where(gap.min(axis=1) <= within_s, nearest, -1)


def read_landmarks(path: str | Path) -> Landmarks:
    """Read ``kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm`` and, where there, ``em_dx,em_dy,em_dz``.

    Raises:
        InputError: the file cannot be read, a column is missing or a value is no number.
    """
    rows = read_csv(path, _LANDMARK, "landmark")
    table = numbers(rows, _LANDMARK)
    axis = tuple(f"em_{name}" for name in _AXIS)
    has_axis = set(axis) <= rows[0].keys()
    return Landmarks(table[:, 3:], table[:, :3], numbers(rows, axis) if has_axis else None)


def read_em_samples(path: str | Path) -> EmSamples:
    """Read ``frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz`` (or ``image`` for ``frame``); all but the position may be missing.

    Raises:
        InputError: the file cannot be read, a column is missing, a value is no number or there is no row.
    """
    rows = read_csv(path, _POSITION, "EM")
    has = rows[0].keys()
    axis = numbers(rows, _AXIS) if set(_AXIS) <= has else np.full((len(rows), 3), np.nan)
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    key = next((name for name in ("image", "frame") if name in has), None)
    return EmSamples(
        position_mm=numbers(rows, _POSITION),
        axis=axis / np.where(length > 1e-9, length, np.nan),
        t_s=numbers(rows, ("t_s",))[:, 0] if "t_s" in has else None,
        key=tuple(row[key].strip() for row in rows) if key else None,
    )


def join_names(names: Sequence[str], images: Sequence[str]) -> NDArray[np.int64]:
    """(M,) row of ``names`` that belongs to each image, -1 where none does.

    The same name counts first; then the same name without folder, ending and leading zeros, unless two rows share it.
    """
    exact = {name: i for i, name in enumerate(names)}
    plain = [_plain(name) for name in names]
    count = Counter(plain)
    loose = {name: i for i, name in enumerate(plain) if count[name] == 1}
    return np.array([exact.get(image, loose.get(_plain(image), -1)) for image in images], int)


def _plain(name: str) -> str:
    stem = Path(name).stem
    return str(int(stem)) if stem.isdecimal() else stem
