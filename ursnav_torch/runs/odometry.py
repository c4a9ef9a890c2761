"""A robot's log: what it reported of its joints, at the times of a video's pictures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ursnav_torch.columns import ODOMETRY_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.tables import numbers, read_csv
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.odometry import OdometryReading

#: Between two reports farther apart than this the robot said nothing.
LONGEST_GAP_S = 0.5


def recorded_odometry(path: Path) -> Callable[[Moment], OdometryReading | None]:
    """The joints at a picture's time, from a CSV file ``t_s,insertion_mm,bend_x_deg,bend_y_deg``.

    Between two reports the joints are interpolated; where the robot said nothing for half a second there is none.

    Raises:
        InputError: the file cannot be read, holds something that is no number, or its times do not rise.
    """
    rows = read_csv(path, ODOMETRY_COLUMNS, "odometry")
    table = numbers(rows, ODOMETRY_COLUMNS)
    t_s, joints = table[:, 0], table[:, 1:] * [1.0, np.pi / 180, np.pi / 180]
    stays = np.flatnonzero(np.diff(t_s) <= 0)
    if len(stays):
        at = int(stays[0])
        raise InputError(
            f"{path}: t_s must rise from row to row, but {t_s[at + 1]:g} s in data row {at + 2} follows {t_s[at]:g} s. "
            "Sort the rows by time, and keep one row a time."
        )

    def reading(moment: Moment) -> OdometryReading | None:
        after = int(np.searchsorted(t_s, moment.t_s))
        around = t_s[max(after - 1, 0) : after + 1]
        if np.abs(around - moment.t_s).min() > LONGEST_GAP_S or np.ptp(around) > LONGEST_GAP_S:
            return None
        return OdometryReading(*(float(np.interp(moment.t_s, t_s, column)) for column in joints.T))

    return reading
