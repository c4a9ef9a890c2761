"""Which reading of an EM log belongs to which picture: by name, by frame number or by time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.em_log.clock import NEAR_S, check_clock, check_pace
from ursnav_torch.em_log.keys import check_counting, check_keys, join_names
from ursnav_torch.em_log.samples import TIME_S, EmFormat, EmSamples
from ursnav_torch.errors import InputError

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

#: Two clocks that part by less than this share of the time passed run at one rate.
_SAME_RATE = 0.02
#: Fewer pictures in step than this say nothing about frame numbers.
_FEW = 3


@dataclass(frozen=True, slots=True, eq=False)
class EmJoin:
    """One reading a picture.

    Attributes:
        samples: M rows, one a picture; not visible where there is none.
        how: by what they were joined, for people to read.
    """

    samples: EmSamples
    how: str

    def said(self) -> str:
        """``22 of 24 pictures have an EM reading (by time)``."""
        seen = self.samples.seen
        return f"{int(seen.sum())} of {len(seen)} pictures have an EM reading ({self.how})"


def join_pictures(
    samples: EmSamples,
    images: Sequence[str],
    t_s: ArrayLike | None = None,
    form: EmFormat | None = None,
    within_s: float = NEAR_S,
) -> EmJoin:
    """One reading a picture: by its name, by its number, or by the nearest time.

    A column ``image`` names pictures. A column ``frame`` may hold the pictures' numbers or the tracker's own; where the
    log has times, too, the two must tell the same: numbers whose times run at another rate than the pictures' are the
    tracker's own.

    Args:
        samples: the log.
        images: M names of the pictures, or their numbers.
        t_s: (M,) their times, where known.
        form: what the log does not tell.
        within_s: largest difference in time.

    Raises:
        InputError: no picture has a reading; times look like another unit's; numbers and times contradict each other.
    """
    form, named = form or EmFormat(), join_names(samples.key or (), images)
    clocks = samples.t_s is not None and t_s is not None and bool(np.isfinite(np.asarray(t_s, float)).any())
    times = np.asarray(t_s, float) if clocks else np.full(len(images), np.nan)
    if form.join is None:
        check_counting(samples, images)
    rows, how = named, f"by {samples.key_column or 'name'}"
    if form.join == "time" or (form.join is None and _by_clock(samples, named, times, within_s)):
        if not clocks:
            raise InputError(f"{samples.source} cannot be joined by time: it has no column t_s, or the pictures none.")
        rows, how = nearest_rows(samples, times, within_s), "by time"
        _check_times(samples, rows, times, within_s, form.time_unit is None)
        if form.join is None and samples.key is None:
            _check_one_each(samples, times, within_s)
        if (named >= 0).any():
            how += "; its frame numbers are the tracker's own"
    if (rows < 0).all():
        raise InputError(_no_reading(samples, images))
    if rows is named:
        check_keys(samples, named, form.join is None)
    found = EmJoin(samples.rows(rows), how)
    if not found.samples.seen.any():
        raise InputError(f"The sensor was not visible in any of the {len(images)} pictures, says {samples.source}.")
    return found


def nearest_rows(samples: EmSamples, t_s: Array, within_s: float = NEAR_S) -> Rows:
    """(M,) row of the reading nearest in time to each picture, -1 where none is within ``within_s``."""
    clock = np.full(len(samples.position_mm), np.nan) if samples.t_s is None else samples.t_s
    known = np.flatnonzero(np.isfinite(clock))
    if not len(known):
        return np.full(len(t_s), -1)
    order = known[np.argsort(clock[known], kind="stable")]
    right = np.searchsorted(clock[order], t_s).clip(0, len(order) - 1)
    left = (right - 1).clip(0)
    nearer = np.abs(clock[order[left]] - t_s) <= np.abs(clock[order[right]] - t_s)
    rows = order[np.where(nearer, left, right)]
    return np.where(np.abs(clock[rows] - t_s) <= within_s, rows, -1)


def _by_clock(samples: EmSamples, named: Rows, times: Array, within_s: float) -> bool:
    """Whether times and not names or numbers tell which reading belongs to which picture.

    Raises:
        InputError: frame numbers and times contradict each other, and nothing says which of them to believe.
    """
    if samples.t_s is None or not np.isfinite(times).any():
        return False
    both = (named >= 0) & np.isfinite(times)
    both[both] = np.isfinite(samples.t_s[named[both]])
    if (named < 0).all():
        return True
    if samples.key_column != "frame" or both.sum() < _FEW:
        return False
    ahead = samples.t_s[named[both]] - times[both]
    offset = float(np.median(ahead))
    if any(_in_step(s * samples.t_s[named[both]], times[both], within_s) for s in TIME_S.values() if s < 1):
        return False  # another unit of time, but the numbers are the pictures'
    in_step = _in_step(samples.t_s[named[both]], times[both], within_s)
    covered = float((nearest_rows(samples, times, within_s) >= 0).mean())
    if in_step and (abs(offset) <= within_s or covered < 0.5):
        return False
    if not in_step and covered >= 0.5 and both.sum() < np.isfinite(samples.t_s).sum():
        return True
    if not in_step:
        check_clock(samples, within_s)
    said = f"its times run {offset:.2f} s ahead" if in_step else "its times run at another rate"
    raise InputError(
        f"{samples.source}: frame numbers and t_s contradict each other: joined by number, {said} than the pictures'. "
        "Say em_join=frame if its frame numbers are the pictures', em_join=time if they are the tracker's own; check "
        "fps= where the pictures come from a folder."
    )


def _in_step(clock: Array, times: Array, within_s: float) -> bool:
    ahead = clock - times
    return bool(np.abs(ahead - np.median(ahead)).max() <= within_s + _SAME_RATE * np.ptp(times))


def _check_times(samples: EmSamples, rows: Rows, times: Array, within_s: float, any_unit: bool) -> None:
    """Refuse times of another unit or of another clock.

    Raises:
        InputError: see there.
    """
    if samples.t_s is None:
        return
    check_clock(samples, within_s)
    found = int((rows >= 0).sum())
    if any_unit and found < 0.5 * len(rows):
        scaled, unit = max((_in_unit(samples, times, within_s, factor), unit) for unit, factor in TIME_S.items())
        if scaled > max(2 * found, _FEW, 0.5 * len(rows)):
            raise InputError(
                f"{found} of {len(rows)} pictures have a reading of {samples.source}, and {scaled} would have one if "
                f"its times were in {unit}. Say em_time_unit={unit} (or s, if they are right), or name the column "
                f"t_{unit}."
            )
    if any_unit:
        check_pace(samples)
    if found == 0:
        first, last = float(np.nanmin(samples.t_s)), float(np.nanmax(samples.t_s))
        raise InputError(
            f"0 of {len(rows)} pictures have a reading of {samples.source}: its times run from {first:.3f} "
            f"to {last:.3f} s, the pictures' from {np.nanmin(times):.3f} to {np.nanmax(times):.3f}: two clocks. "
            "Say em_offset_s=, what the log's clock shows when the pictures' shows zero "
            f"({first - np.nanmin(times):.3f} lets both begin together)."
        )


def _in_unit(samples: EmSamples, times: Array, within_s: float, factor: float) -> int:
    """How many pictures would have readings of their own if the log's seconds were ``factor`` of one."""
    near = nearest_rows(replace(samples, t_s=np.asarray(samples.t_s) * factor), times, within_s)
    return len(np.unique(near[near >= 0]))  # a clock that stands still in this unit is none


def _check_one_each(samples: EmSamples, times: Array, within_s: float) -> None:
    """Refuse a log of as many readings as there are pictures whose times are not those of the pictures.

    Raises:
        InputError: they are not.
    """
    t = np.sort(np.asarray(samples.t_s, float))
    if len(t) != len(times) or not np.isfinite([t, times]).all() or np.abs(t - times).max() <= within_s:
        return
    raise InputError(
        f"{samples.source} has {len(t)} readings, as many as there are pictures, but its times run from {t[0]:.3f} to "
        f"{t[-1]:.3f} s, the pictures' from {times[0]:.3f} to {times[-1]:.3f}. If each reading belongs to one picture, "
        "add a column frame that numbers them from 0; if the clocks are right, say em_join=time; if one is ahead, say "
        "em_offset_s= (and fps= where the pictures come from a folder)."
    )


def _no_reading(samples: EmSamples, images: Sequence[str]) -> str:
    first = None if samples.key is None else samples.key[0]
    return (
        f"0 of {len(images)} pictures have an EM reading: {samples.source} names {first!r} first, the pictures "
        f"{images[0] if images else None!r}. Give the EM file a column image or frame that names them, or t_s in both."
    )
