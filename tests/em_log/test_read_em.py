"""EM logs are read as their writers meant them: units, clocks, and words for "not visible"."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.em_log import EmFormat, read_em_samples
from ursnav_torch.errors import InputError

#: A path of ten positions, some cm long, in a field generator's frame.
PATH_MM = np.array([200.0, -30, 80]) + np.arange(10)[:, None] * [2.0, 1.0, -1.5]


def write(path: Path, head: str, rows: list[str]) -> Path:
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


def log(path: Path, head: str, factor: float = 1.0, step: float = 0.025) -> Path:
    return write(path, head, [",".join(map(str, (n * step, *p))) for n, p in enumerate(PATH_MM * factor)])


def test_samples_have_unit_axes_and_nan_where_blank(tmp_path: Path) -> None:
    rows = ["0,0.0,1,2,3,0,0,2", "1,0.1,,,,,,", "2,0.2,4,5,6,3,0,4"]
    samples = read_em_samples(write(tmp_path / "em.csv", "frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz", rows))
    np.testing.assert_allclose(samples.axis[[0, 2]], [[0, 0, 1], [0.6, 0, 0.8]])
    assert samples.seen.tolist() == [True, False, True]
    assert samples.visible().key == ("0", "2")


@pytest.mark.parametrize(
    ("head", "factor", "step"),
    [
        ("t_s,x_mm,y_mm,z_mm", 1.0, 0.025),
        ("t_ms,x_cm,y_cm,z_cm", 0.1, 25),
        ("t_us,x_m,y_m,z_m", 1e-3, 25_000),
        ("T_NS,X_MM,Y_MM,Z_MM", 1.0, 25e6),
    ],
)
def test_units_are_taken_from_the_column_names(tmp_path: Path, head: str, factor: float, step: float) -> None:
    samples = read_em_samples(log(tmp_path / "em.csv", head, factor, step))
    np.testing.assert_allclose(samples.position_mm, PATH_MM)
    assert samples.t_s is not None
    np.testing.assert_allclose(samples.t_s, np.arange(10) * 0.025)


def test_units_that_no_name_tells_are_asked_for(tmp_path: Path) -> None:
    path = log(tmp_path / "em.csv", "timestamp,x,y,z", 0.1, 25)
    with pytest.raises(InputError, match=r"x,y,z and does not say their unit: set em_unit= to one of mm, cm, m"):
        read_em_samples(path)
    with pytest.raises(InputError, match=r"column timestamp and does not say its unit: set em_time_unit="):
        read_em_samples(path, EmFormat(unit="cm"))
    samples = read_em_samples(path, EmFormat(unit="cm", time_unit="ms", offset_s=0.025))
    np.testing.assert_allclose(samples.position_mm, PATH_MM)
    assert samples.t_s is not None
    np.testing.assert_allclose(samples.t_s, np.arange(10) * 0.025 - 0.025)
    with pytest.raises(InputError, match="em_unit is 'inch'; accepted are mm, cm, m"):
        EmFormat(unit="inch")


def test_meters_under_a_name_in_mm_are_refused_by_their_spread(tmp_path: Path) -> None:
    path = log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", 1e-3)
    with pytest.raises(InputError, match=r"lie within 0\.024 mm.*em_unit=m \(or cm, in\); if they are right"):
        read_em_samples(path)
    np.testing.assert_allclose(read_em_samples(path, EmFormat(unit="m")).position_mm, PATH_MM)
    assert read_em_samples(path, EmFormat(unit="mm")).position_mm.max() < 1


def test_positions_beyond_any_field_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 2: the position .* farther away than any tracker reaches \(5000 mm\)"):
        read_em_samples(log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", 1e3))


@pytest.mark.parametrize(
    "cells",
    [
        "-3.697314E28,-3.697314E28,-3.697314E28,1,0,0",
        "NaN,NaN,NaN,NaN,NaN,NaN",
        "nan,1,2,1,0,0",
        "-9999,-9999,-9999,0,0,1",
        "0,0,0,0,0,0",
        ",,,,,",
        "MISSING,MISSING,MISSING,,,",
        "inf,inf,inf,0,0,1",
        "null,null,null,null,null,null",
    ],
)
def test_words_for_a_sensor_that_was_not_visible(tmp_path: Path, cells: str) -> None:
    rows = ["200,-30,80,0,0,1", cells, cells, "201,-31,80,0,0,1"]
    samples = read_em_samples(write(tmp_path / "em.csv", "x_mm,y_mm,z_mm,dx,dy,dz", rows))
    assert samples.seen.tolist() == [True, False, False, True]
    assert np.isnan(samples.axis[1]).all()


@pytest.mark.parametrize("word", ["-9999", "-1", "999"])
def test_a_word_for_not_visible_in_the_direction_too_is_no_direction(tmp_path: Path, word: str) -> None:
    rows = [f"{200 + i},-30,80,0,0,1" for i in range(12)]
    rows[3:5] = [",".join([word] * 6)] * 2
    samples = read_em_samples(write(tmp_path / "em.csv", "x_mm,y_mm,z_mm,dx,dy,dz", rows))
    assert np.flatnonzero(~samples.seen).tolist() == [3, 4]
    np.testing.assert_array_equal(np.isfinite(samples.axis).all(axis=1), samples.seen)


def test_a_quaternion_counts_only_where_the_sensor_is_visible(tmp_path: Path) -> None:
    rows = ["200,-30,80,0,0,0,1,1", "201,-31,80,-9999,-9999,-9999,-9999,0", "202,-32,80,0,0,0,1,1"]
    path = tmp_path / "em.csv"
    samples = read_em_samples(write(path, "x_mm,y_mm,z_mm,qx,qy,qz,qw,visible", rows))
    assert samples.seen.tolist() == [True, False, True] and samples.quaternion is not None
    assert np.isnan(samples.quaternion[1]).all() and np.isnan(samples.axis[1]).all()
    rows[1] = rows[1].removesuffix("0") + "1"
    with pytest.raises(InputError, match="line 3: the quaternion has the length"):
        read_em_samples(write(path, "x_mm,y_mm,z_mm,qx,qy,qz,qw,visible", rows))


@pytest.mark.parametrize(
    ("column", "seen", "unseen"),
    [
        ("state", "OK", "Missing"),
        ("visible", "true", "false"),
        ("status", "ENABLED", "PARTIALLY_OUT_OF_VOLUME"),
        ("out_of_volume", "0", "1"),
        ("Valid", "1", "0"),
    ],
)
def test_flags_say_whether_the_sensor_was_visible(tmp_path: Path, column: str, seen: str, unseen: str) -> None:
    rows = [f"200,-30,80,{seen}", f"201,-31,80,{unseen}"]
    assert read_em_samples(write(tmp_path / "em.csv", f"x_mm,y_mm,z_mm,{column}", rows)).seen.tolist() == [True, False]


def test_a_flag_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "em.csv", "x_mm,y_mm,z_mm,status", ["200,-30,80,ok", "201,-31,80,purple"])
    with pytest.raises(InputError, match=r"line 3: status is 'purple'; known are .*Rename the column"):
        read_em_samples(path)


def test_a_position_at_the_origin_counts_where_others_are_near_it(tmp_path: Path) -> None:
    path = write(tmp_path / "em.csv", "x_mm,y_mm,z_mm", ["0,0,0", "1,0,0", "2,0,0"])
    assert read_em_samples(path).seen.all()


def test_ndi_columns_give_position_and_axis_of_six_degrees(tmp_path: Path) -> None:
    s = np.sqrt(0.5)
    path = write(tmp_path / "em.csv", "Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz", [f"48123,OK,{s},0,{s},0,200,-30,80"])
    samples = read_em_samples(path)
    np.testing.assert_allclose(samples.position_mm, [[200, -30, 80]])
    np.testing.assert_allclose(samples.axis, [[1, 0, 0]], atol=1e-12)  # z of a quarter turn about y
    assert samples.quaternion is not None and samples.key == ("48123",)
    np.testing.assert_allclose(samples.quaternion, [[0, s, 0, s]])


@pytest.mark.parametrize(
    ("head", "row", "match"),
    [
        ("frame,x_mm,y_mm,z_mm", "", r"EM file .* has no rows"),
        ("frame,x_mm,y_mm", "0,1,2", r"lacks the column\(s\) z_mm; it has frame, x_mm, y_mm"),
        ("t_s,x_mm,y_mm,z_mm", ",1,2,3", r"the column t_s is blank in all 1 rows"),
        ("t_s,x_mm,y_mm,z_mm", "0,00,3,92,3,16,7,78", r"line 2 has 8 cells, the header 4; are there decimal commas\?"),
        ("t_s,x_mm,y_mm,z_mm", '0,"3,92",3,7', r"x_mm is '3,92'.*write a decimal point"),
    ],
)
def test_logs_that_cannot_be_used_are_refused(tmp_path: Path, head: str, row: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        read_em_samples(write(tmp_path / "em.csv", head, [row]))


def _log(path: Path, header: str, rows: list[str], encoding: str = "utf-8") -> Path:
    path.write_bytes("\n".join([header, *rows, ""]).encode(encoding))
    return path


PLACES = [[120 + i, -40 + 2 * (i % 5), 90 - i] for i in range(24)]
TEXT = [f"{i / 10},{x},{y},{z}" for i, (x, y, z) in enumerate(PLACES)]


@pytest.mark.parametrize(
    "header", ["Time [s],X [mm],Y [mm],Z [mm]", "t_s,X(mm),Y(mm),Z(mm)", "# log v2\nt_s,x_mm,y_mm,z_mm"]
)
def test_headers_as_other_programs_write_them(tmp_path: Path, header: str) -> None:
    samples = read_em_samples(_log(tmp_path / "em.csv", header, TEXT))
    np.testing.assert_allclose(samples.position_mm, PLACES)
    assert samples.t_s is not None and samples.t_s[3] == pytest.approx(0.3)


def test_microseconds_have_two_spellings(tmp_path: Path) -> None:
    rows = [f"{100_000 * i},{x},{y},{z}" for i, (x, y, z) in enumerate(PLACES)]
    samples = read_em_samples(_log(tmp_path / "em.csv", "t_µs,x_mm,y_mm,z_mm", rows))
    assert samples.t_s is not None and samples.t_s[3] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("t_s,x_mm,y_mm,z_mm", "-1,-1,-1"), ("t_s,x_mm,y_mm,z_mm", "999,999,999"),
        ("t_s,x_mm,y_mm,z_mm,dx,dy,dz", "0,0,0,0,0,1"), ("t_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", "0,0,0,0,0,0,1"),
    ],
)  # fmt: skip
def test_one_number_three_times_is_no_place(tmp_path: Path, header: str, cells: str) -> None:
    more = {7: ",0,0.6,0.8", 8: ",0,0.6,0,0.8"}.get(len(header.split(",")), "")
    rows = [f"{i / 10},{cells}" if i % 3 == 0 else row + more for i, row in enumerate(TEXT)]
    samples = read_em_samples(_log(tmp_path / "em.csv", header, rows))
    assert samples.seen.tolist() == [i % 3 != 0 for i in range(24)]


def test_readings_that_stand_still_to_the_last_digit_are_said(tmp_path: Path) -> None:
    rows = [f"{i / 10}," + TEXT[min(i, 8)].partition(",")[2] for i in range(24)]
    with pytest.warns(UserWarning, match="lines 10 to 25: 16 readings are the same to the last digit"):
        read_em_samples(_log(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm", rows))


@pytest.mark.parametrize(
    ("header", "rows", "reason"),
    [
        ("t_s;x_mm;y_mm;z_mm", [r.replace(",", ";") for r in TEXT], "has semicolons between its cells"),
        ("t_s\tx_mm\ty_mm\tz_mm", [r.replace(",", "\t") for r in TEXT], "has tabs between its cells"),
        ("t_s x_mm y_mm z_mm", [r.replace(",", " ") for r in TEXT], "has blanks between its cells"),
        ("t_s,X_mm,x_mm,y_mm,z_mm", [f"5,{r}" for r in TEXT], "columns X_mm and x_mm for one thing"),
    ],
)
def test_tables_of_other_separators_are_told(tmp_path: Path, header: str, rows: list[str], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        read_em_samples(_log(tmp_path / "em.csv", header, rows))
