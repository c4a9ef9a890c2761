"""A robot's log, joined with pictures by time."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.runs.sources import recorded_odometry
from ursnav_torch.tracking.follow import Moment


def moment(t_s: float) -> Moment:
    return Moment(0, t_s, np.zeros((0, 0), np.uint8), "0")


def log(tmp_path: Path, *rows: str) -> Path:
    path = tmp_path / "robot.csv"
    path.write_text("t_s,insertion_mm,bend_x_deg,bend_y_deg\n" + "\n".join(rows) + "\n")
    return path


def test_joints_are_interpolated_and_degrees_become_radians(tmp_path: Path) -> None:
    reading = recorded_odometry(log(tmp_path, "0,10,0,90", "0.2,12,9,90"))(moment(0.05))
    assert reading is not None
    assert reading.insertion_mm == pytest.approx(10.5)
    assert reading.bend_x_rad == pytest.approx(np.radians(2.25))
    assert reading.bend_y_rad == pytest.approx(np.pi / 2)


def test_where_the_robot_said_nothing_there_is_no_reading(tmp_path: Path) -> None:
    reading = recorded_odometry(log(tmp_path, "0,1,0,0", "0.1,1,0,0", "3,2,0,0", "3.1,2,0,0"))
    assert reading(moment(1.5)) is None
    assert reading(moment(9.0)) is None
    assert reading(moment(3.05)) is not None


def test_times_that_fall_and_cells_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0\.1 s in data row 3 follows 0\.2 s"):
        recorded_odometry(log(tmp_path, "0,1,0,0", "0.2,1,0,0", "0.1,1,0,0"))
    with pytest.raises(InputError, match="insertion_mm"):
        recorded_odometry(log(tmp_path, "0,deep,0,0"))


def test_a_row_without_all_joints_is_no_report_and_one_without_its_time_is_refused(tmp_path: Path) -> None:
    """A blank cell made every later picture's motion unknown."""
    reading = recorded_odometry(log(tmp_path, "0,1,0,0", "0.1,,0,0", "0.2,2,0,0", "0.3,3,0,"))
    between = reading(moment(0.1))
    assert between is not None and between.insertion_mm == pytest.approx(1.5)
    assert reading(moment(0.25)) == reading(moment(0.2))
    with pytest.raises(InputError, match="data row 2 has no t_s"):
        recorded_odometry(log(tmp_path, "0,1,0,0", ",1,0,0"))
    with pytest.raises(InputError, match="no row has all of"):
        recorded_odometry(log(tmp_path, "0,1,,0"))
