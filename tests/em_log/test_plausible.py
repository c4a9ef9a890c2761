"""EM logs that cannot be what they say they are: lengths and clocks of another unit, stuck, set or of two sensors."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.em_log import EmFormat, EmSamples, join_pictures, read_em_samples
from ursnav_torch.errors import InputError

#: A scope for half a minute at 10 readings a second, in the frame of a field generator, and as many pictures.
TIMES = np.arange(300) / 10
NAMES = [str(n) for n in range(300)]
PATH_MM = np.stack([150 + 25 * np.sin(0.4 * TIMES), -40 + 20 * np.cos(0.3 * TIMES), -120 + 1.0 * TIMES], axis=1)


def log(path: Path, head: str, *columns: np.ndarray) -> Path:
    table = np.column_stack(columns)
    lines = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([head, *lines, ""]), encoding="utf-8")
    return path


def joined(path: Path, form: EmFormat | None = None) -> EmSamples:
    return join_pictures(read_em_samples(path, form), NAMES, TIMES, form).samples


@pytest.mark.parametrize(
    ("head", "factor", "unit", "reason"),
    [
        ("x_mm,y_mm,z_mm", 0.1, "cm", r"lie within .* mm and no farther than .*em_unit=cm"),
        ("x_mm,y_mm,z_mm", 1e-3, "m", r"closer than a sensor that is held still.*em_unit=m"),
        ("x_mm,y_mm,z_mm", 1 / 25.4, "in", r"in inches em_unit=in"),
        ("Tx,Ty,Tz", 0.1, "cm", r"em_unit=cm"),
        ("x_cm,y_cm,z_cm", 1.0, "mm", r"spread over [\d.]+ mm, and no kidney is as large.*em_unit=mm"),
        ("x_cm,y_cm,z_cm", 1e-3, "m", r"em_unit=cm"),
        ("x_m,y_m,z_m", 1.0, "mm", r"farther away than any tracker reaches"),
    ],
)
def test_lengths_of_another_unit_than_the_column_says_are_asked_about(
    tmp_path: Path, head: str, factor: float, unit: str | None, reason: str
) -> None:
    path = log(tmp_path / "em.csv", f"t_s,{head}", TIMES, PATH_MM * factor)
    with pytest.raises(InputError, match=reason):
        read_em_samples(path)
    if unit is not None:
        np.testing.assert_allclose(read_em_samples(path, EmFormat(unit=unit)).position_mm, PATH_MM)


def test_a_short_path_is_right_where_it_is_far_from_the_field_generator_or_said_to_be(tmp_path: Path) -> None:
    short = log(tmp_path / "short.csv", "x_mm,y_mm,z_mm", PATH_MM * 0.1 + [100, 0, 0])
    assert read_em_samples(short).seen.all()
    near = log(tmp_path / "near.csv", "x_mm,y_mm,z_mm", PATH_MM * 0.1)
    assert read_em_samples(near, EmFormat(unit="mm")).position_mm.max() < 20


@pytest.mark.parametrize(
    ("clock", "where"),
    [
        (0 * TIMES + 3, "still at 3.000 s over its lines 2 to 301"),
        (np.minimum(TIMES, 10), "still at 10.000 s over its lines 102 to 301"),
        (np.maximum(TIMES, 10), "still at 10.000 s over its lines 2 to 102"),
        (np.where((TIMES > 10) & (TIMES < 20), 10, TIMES), "still at 10.000 s over its lines 102 to 201"),
        (np.floor(TIMES), "still at 0.000 s over its lines 2 to 11"),
    ],
    ids=["always", "at the end", "at the beginning", "between", "whole seconds"],
)
def test_a_clock_that_stands_still_is_refused(tmp_path: Path, clock: np.ndarray, where: str) -> None:
    path = log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", clock, PATH_MM)
    with pytest.raises(InputError, match=f"stands {where}, in which the sensor moves.*Blank those times"):
        joined(path)
    numbered = log(tmp_path / "n.csv", "frame,t_s,x_mm,y_mm,z_mm", np.arange(300), clock, PATH_MM)
    np.testing.assert_allclose(joined(numbered, EmFormat(join="frame")).position_mm, PATH_MM)


def test_a_clock_that_ticks_more_slowly_than_the_sensor_is_read_will_do(tmp_path: Path) -> None:
    path = log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", np.floor(TIMES * 5) / 5, PATH_MM)
    np.testing.assert_allclose(joined(path).position_mm, PATH_MM, atol=1.5)
    still = log(tmp_path / "still.csv", "t_s,x_mm,y_mm,z_mm", np.r_[TIMES, 30], np.r_[PATH_MM, PATH_MM[-1:]])
    assert joined(still).seen.all()


@pytest.mark.parametrize(
    ("head", "factor", "reason"),
    [
        ("t_s", 1e3, "em_time_unit=ms"),
        ("t_s", 1e7, "em_time_unit=ticks"),
        ("t_s", 1 / 60, "em_time_unit=min"),
        ("t_ms", 1.0, r"0\.0001 s apart, 1e\+04 readings a second; EM trackers give 0\.5 to 2000"),
        ("t_ms", 1e6, "em_time_unit=ms"),
        ("t_s", 1 / 3600, "readings a second; EM trackers give"),
    ],
)
def test_times_of_another_unit_than_the_column_says_are_asked_about(
    tmp_path: Path, head: str, factor: float, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        joined(log(tmp_path / "em.csv", f"{head},x_mm,y_mm,z_mm", TIMES * factor, PATH_MM))


def test_milliseconds_since_1970_under_a_name_in_seconds_are_asked_about(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"100 s apart, 0\.01 readings a second.*Say em_time_unit="):
        joined(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", 1.7e12 + TIMES * 1e3, PATH_MM))


@pytest.mark.parametrize(
    "clock",
    [TIMES % 1, TIMES % 10, (TIMES * 1e3 % 16384) / 1e3, TIMES - 1.0 * (TIMES > 10), np.where(TIMES == 7, 0, TIMES)],
    ids=["fractions of a second", "seconds of a minute", "a counter of 14 bits", "set back", "one row"],
)
def test_a_clock_that_wraps_or_is_set_back_is_refused(tmp_path: Path, clock: np.ndarray) -> None:
    with pytest.raises(InputError, match="jumps back from"):
        joined(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", clock, PATH_MM))


def test_a_clock_that_is_set_by_a_little_is_said(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"goes back 1 times, by up to 0\.050 s"):
        joined(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", TIMES - 0.15 * (TIMES > 10), PATH_MM))
    more = np.r_[PATH_MM, PATH_MM[-1:]]
    for ahead in (0.4, 3600.0):
        clock = np.r_[TIMES, 30.0] + ahead * (np.arange(301) > 100)
        with pytest.warns(UserWarning, match=r"jumps ahead from 10\.000 to .* s between its lines 102 to 103"):
            joined(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", clock, more))


@pytest.mark.parametrize("clock", [TIMES * 1.05, TIMES + 5, TIMES - 5], ids=["drifts", "ahead", "behind"])
def test_as_many_readings_as_pictures_at_other_times_are_asked_about(tmp_path: Path, clock: np.ndarray) -> None:
    path = log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", clock, PATH_MM)
    with pytest.raises(InputError, match=r"300 readings, as many as there are pictures.*em_join=time.*em_offset_s="):
        joined(path)
    assert joined(path, EmFormat(join="time")).seen.sum() > 200


def test_sensors_of_one_log_are_told_apart(tmp_path: Path) -> None:
    both = np.stack([PATH_MM, PATH_MM + np.array([0, 80, 0])], axis=1).reshape(-1, 3)
    head, numbers = "t_s,x_mm,y_mm,z_mm", np.arange(600) % 2
    named = log(tmp_path / "named.csv", f"sensor,{head}", numbers, TIMES.repeat(2), both)
    with pytest.raises(InputError, match=r"readings of 2 sensor\(s\) by its column sensor \(0\.0, 1\.0\).*em_tool="):
        read_em_samples(named)
    np.testing.assert_allclose(read_em_samples(named, EmFormat(tool="1.0")).position_mm, both[1::2])
    with pytest.raises(InputError, match="same again after 2 rows: 2 sensors in one log"):
        read_em_samples(log(tmp_path / "mixed.csv", head, TIMES.repeat(2), both))
    with pytest.raises(InputError, match=r"several positions in a row \(Tx\.1, Ty\.1, Tz\.1\)"):
        read_em_samples(log(tmp_path / "wide.csv", "t_s,Tx,Ty,Tz,Tx.1,Ty.1,Tz.1", TIMES, PATH_MM, PATH_MM + 50))


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        (0 * TIMES + 7, r"300 readings of frame 7, its lines 2 to 301, \d\d mm apart"),
        (np.arange(300) % 64, r"readings of frame \d+, .* a counter that begins anew"),
        (np.arange(300) * 2, r"Only 150 of 300 pictures .* by frame number, and 50% of its readings no picture"),
    ],
    ids=["stuck", "wraps", "every second"],
)
def test_frame_numbers_that_are_not_the_pictures_are_refused(tmp_path: Path, numbers: np.ndarray, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        joined(log(tmp_path / "em.csv", "frame,x_mm,y_mm,z_mm", numbers, PATH_MM))


def test_a_picture_may_have_several_readings_and_the_first_counts(tmp_path: Path) -> None:
    path = log(tmp_path / "em.csv", "frame,x_mm,y_mm,z_mm", np.arange(300) // 2, PATH_MM)
    found = join_pictures(read_em_samples(path), NAMES[:150])
    np.testing.assert_allclose(found.samples.position_mm, PATH_MM[::2])


def test_orientations_that_are_not_read_are_said_and_quaternions_that_are_none_refused(tmp_path: Path) -> None:
    angles = np.random.default_rng(0).uniform(-90, 90, (300, 3))
    with pytest.warns(UserWarning, match=r"columns azimuth, elevation, roll are not read"):
        read_em_samples(log(tmp_path / "a.csv", "x_mm,y_mm,z_mm,azimuth,elevation,roll", PATH_MM, angles))
    with pytest.raises(InputError, match=r"line 2: the quaternion has the length 5, expected 1"):
        rows = np.tile([0, 0, 0, 5.0], (300, 1))
        read_em_samples(log(tmp_path / "q.csv", "x_mm,y_mm,z_mm,qx,qy,qz,qw", PATH_MM, rows))


def test_readings_that_are_all_the_same_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"All 300 readings of .* are the same to the last digit"):
        read_em_samples(log(tmp_path / "em.csv", "x_mm,y_mm,z_mm", np.tile([150.0, -40, -120], (300, 1))))


def test_a_clock_that_stands_beside_frame_numbers_is_named_as_the_reason(tmp_path: Path) -> None:
    path = log(tmp_path / "em.csv", "frame,t_s,x_mm,y_mm,z_mm", np.arange(300), 0 * TIMES + 3, PATH_MM)
    with pytest.raises(InputError, match=r"em\.csv stands still at 3\.000 s over its lines 2 to 301.*em_join=frame"):
        joined(path)


def test_axes_of_many_lengths_are_none(tmp_path: Path) -> None:
    angles = np.stack([45 + TIMES, 30 - TIMES, 10 + 0 * TIMES], axis=1)
    with pytest.raises(InputError, match=r"em\.csv: dx, dy, dz are .* long; a sensor's axis has one length"):
        read_em_samples(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm,dx,dy,dz", TIMES, PATH_MM, angles))


def test_a_time_of_day_is_told_as_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "em.csv").write_text("timestamp,x_mm,y_mm,z_mm\n10:00:01.5,1,2,3\n")
    with pytest.raises(InputError, match=r"line 2: timestamp is '10:00:01\.5', expected a finite number"):
        read_em_samples(tmp_path / "em.csv")
