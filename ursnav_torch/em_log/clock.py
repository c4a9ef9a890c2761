"""Can an EM log's clock be believed? One that stands still, jumps, or ticks as no tracker does is refused or said."""

import warnings

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.em_log.samples import TIME_S, EmSamples
from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

#: A reading belongs to a picture taken within this time, s.
NEAR_S = 0.25
#: Seconds between readings: trackers give some to some hundred a second (NDI Aurora 40, trakSTAR up to 255, an
#: optical one up to 1000).
_STEP_S = (0.5e-3, 2.0)
#: Packets may overtake each other by so many steps of the clock, and by this at least, s.
_OVERTAKEN, _OVERTAKEN_S = 5, 0.01
#: A step ahead of so many usual ones is a pause, or a clock that was set.
_PAUSE = 2.5
#: Fewer steps than this tell no pace; and fewer than that may stand in any order.
_FEW, _MANY = 3, 10


def check_clock(samples: EmSamples, within_s: float = NEAR_S) -> None:
    """Refuse a clock that jumps back or stands still while the sensor moves; say one that jumps ahead.

    Raises:
        InputError: one time stands for several moments.
    """
    if samples.t_s is None or (rows := np.flatnonzero(np.isfinite(samples.t_s))).size < 2:
        return
    t = samples.t_s[rows]
    steps = np.diff(t)
    if not (steps > 0).any():
        if (steps < 0).any():  # written from the last to the first
            return
        _check_standing(samples, rows, steps, within_s)
        return
    pace = float(np.median(steps[steps > 0]))
    if (at := np.flatnonzero(steps < -min(within_s, max(_OVERTAKEN * pace, _OVERTAKEN_S)))).size:
        raise InputError(
            f"The clock of {samples.source} jumps back from {t[at[0]]:.3f} to {t[at[0] + 1]:.3f} s between "
            f"{samples.stretch(rows[at[0]], rows[at[0] + 1])}: two recordings in one file? Give the one that belongs "
            "to the pictures."
        )
    _check_standing(samples, rows, steps, within_s)
    if (back := steps < 0).any() and len(steps) >= _MANY:
        warnings.warn(
            f"The clock of {samples.source} goes back {int(back.sum())} times, by up to {-steps.min():.3f} s: was it "
            "set while it ran? Readings about there are so much too early or too late.",
            stacklevel=3,
        )
    ahead = int(steps.argmax())
    if steps[ahead] > max(within_s, _PAUSE * pace):
        warnings.warn(
            f"The clock of {samples.source} jumps ahead from {t[ahead]:.3f} to {t[ahead + 1]:.3f} s between "
            f"{samples.stretch(rows[ahead], rows[ahead + 1])}. If the tracker did not pause there, its later "
            "readings are too late.",
            stacklevel=3,
        )


def _check_standing(samples: EmSamples, rows: NDArray[np.int64], steps: Array, within_s: float) -> None:
    """Refuse a time that several places of the sensor share for longer than ``within_s``.

    A clock may tick more slowly than the sensor is read, as Windows' does in steps of 16 ms: what counts is how long
    it stands. After its last tick that is told by how many readings a second there were before.
    """
    ends = np.concatenate([[0], np.flatnonzero(steps != 0) + 1, [len(rows)]])
    stood = np.abs(np.concatenate([steps[ends[1:-1] - 1], [np.nan]]))
    counts = np.diff(ends)
    usual = float(np.median(stood[:-1] / counts[:-1])) if len(counts) > 1 else np.inf
    stood = np.fmax(stood, np.where(counts > 1, (counts - 1) * usual, 0.0))
    for i in np.flatnonzero((stood > within_s) & (counts > 1)):
        places = samples.position_mm[rows[ends[i] : ends[i + 1]]]
        places = places[np.isfinite(places).all(axis=1)]
        if len(places) > 1 and np.ptp(places, axis=0).max() > 0:
            assert samples.t_s is not None
            raise InputError(
                f"The clock of {samples.source} stands still at {samples.t_s[rows[ends[i]]]:.3f} s over "
                f"{samples.stretch(rows[ends[i]], rows[ends[i + 1] - 1])}, in which the sensor moves: nothing says "
                "when each was taken. Blank those times if only some are wrong; delete the column and give a column "
                "frame or image (or em_join=frame) if it names the pictures; or export with finer times."
            )


def check_pace(samples: EmSamples) -> None:
    """Refuse times that are too close together, or too far apart, for the unit they are said to be in.

    Raises:
        InputError: no tracker reads a sensor so often, or so seldom.
    """
    t = np.array([]) if samples.t_s is None else samples.t_s
    steps = np.diff(np.unique(t[np.isfinite(t)]))
    if len(steps) < _FEW or _STEP_S[0] <= (step := float(np.median(steps))) <= _STEP_S[1]:
        return
    raise InputError(
        f"The times of {samples.source} are {step:.3g} s apart, {1 / step:.3g} readings a second; EM trackers give "
        f"{1 / _STEP_S[1]:g} to {1 / _STEP_S[0]:g}. Say em_time_unit= ({', '.join(TIME_S)}; the one it is said to be "
        "in if that is right), or write seconds."
    )
