"""Which reading belongs to which picture; and how many pictures have one is always said."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.em_log import EmFormat, join_names, join_pictures, read_em_samples
from ursnav_torch.errors import InputError

#: 24 pictures at 10 a second, and a sensor that moves along x by 1 mm a tenth of a second.
NAMES = [f"{i:05d}.png" for i in range(24)]
TIMES = np.arange(24) / 10


def log(path: Path, rate: float = 40.0, n: int = 93, *, frame0: int | None = None, clock: float = 0.0, s: float = 1.0):
    head = ("" if frame0 is None else "frame,") + "t_s,x_mm,y_mm,z_mm"
    rows = []
    for i in range(n):
        t = i / rate
        number = [] if frame0 is None else [frame0 + i]
        rows.append(",".join(map(str, (*number, round((t + clock) / s, 9), 100 + 10 * t, 5, 7))))
    path.write_text("\n".join([head, *rows]) + "\n")
    return read_em_samples(path)


def test_readings_are_joined_by_frame_number(tmp_path: Path) -> None:
    path = tmp_path / "em.csv"
    path.write_text("frame,x_mm,y_mm,z_mm\n0,0,0,0\n12,12,0,0\n7,7,0,0\n")
    joined = join_pictures(read_em_samples(path), ["00012.png", "00007.png", "00099.png"])
    np.testing.assert_array_equal(joined.samples.position_mm[:, 0], [12, 7, np.nan])
    assert joined.said() == "2 of 3 pictures have an EM reading (by frame)"


def test_readings_are_joined_by_the_nearest_time_where_names_say_nothing(tmp_path: Path) -> None:
    path = tmp_path / "em.csv"
    path.write_text("t_s,x_mm,y_mm,z_mm\n0.2,2,0,0\n0.0,0,0,0\n,9,9,9\n0.1,1,0,0\n")
    samples = read_em_samples(path)
    joined = join_pictures(samples, ["a.png", "b.png", "c.png"], [0.19, 0.04, 5.0])
    np.testing.assert_array_equal(joined.samples.position_mm[:, 0], [2, 0, np.nan])
    with pytest.raises(InputError, match="0 of 1 pictures have an EM reading"):
        join_pictures(samples, ["a.png"])


@pytest.mark.parametrize("frame0", [None, 0, 48123, 5])
@pytest.mark.parametrize("rate", [40.0, 60.0])
def test_the_trackers_own_frame_numbers_do_not_count(tmp_path: Path, frame0: int | None, rate: float) -> None:
    joined = join_pictures(log(tmp_path / "em.csv", rate, int(2.4 * rate), frame0=frame0), NAMES, TIMES)
    np.testing.assert_allclose(joined.samples.position_mm[:, 0], 100 + 10 * TIMES, atol=10 * 0.5 / rate + 1e-9)
    assert joined.said().startswith("24 of 24 pictures have an EM reading (by time")


def test_frame_numbers_of_the_pictures_count_whatever_the_clock(tmp_path: Path) -> None:
    for clock, s in ((0.0, 1.0), (1.7e9, 1.0), (0.0, 1e-3)):
        samples = log(tmp_path / "em.csv", 10.0, 24, frame0=0, clock=clock, s=s)
        joined = join_pictures(samples, NAMES, TIMES)
        np.testing.assert_allclose(joined.samples.position_mm[:, 0], 100 + 10 * TIMES)
        assert joined.how == "by frame"


@pytest.mark.parametrize(
    ("rate", "n", "frame0", "clock"),
    [(10.0, 40, 0, 1.0), (15.0, 24, 0, 0.0), (10.0, 30, 0, -0.6)],
)
def test_numbers_and_times_that_contradict_each_other_are_asked_about(
    tmp_path: Path, rate: float, n: int, frame0: int, clock: float
) -> None:
    samples = log(tmp_path / "em.csv", rate, n, frame0=frame0, clock=clock)
    with pytest.raises(InputError, match=r"contradict each other.*em_join=frame.*em_join=time"):
        join_pictures(samples, NAMES, TIMES)
    by_frame = join_pictures(samples, NAMES, TIMES, EmFormat(join="frame"))
    np.testing.assert_allclose(by_frame.samples.position_mm[:, 0], 100 + 10 * np.arange(24) / rate)
    by_time = join_pictures(samples, NAMES, TIMES, EmFormat(join="time"))
    assert by_time.how.startswith("by time; its frame numbers are the tracker's own")


@pytest.mark.parametrize(("unit", "s"), [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_times_of_another_unit_are_named(tmp_path: Path, unit: str, s: float) -> None:
    samples = log(tmp_path / "em.csv", s=s)
    with pytest.raises(InputError, match=rf"24 would have one if its times were in {unit}\. Say em_time_unit={unit}"):
        join_pictures(samples, NAMES, TIMES)
    form = EmFormat(time_unit=unit)
    joined = join_pictures(read_em_samples(tmp_path / "em.csv", form), NAMES, TIMES, form)
    np.testing.assert_allclose(joined.samples.position_mm[:, 0], 100 + 10 * TIMES, atol=0.13)


@pytest.mark.parametrize("clock", [1.7e9, 86_400.0, -100.0])
def test_another_clock_is_named_with_its_offset(tmp_path: Path, clock: float) -> None:
    samples = log(tmp_path / "em.csv", clock=clock)
    with pytest.raises(InputError, match=rf"0 of 24 pictures.*em_offset_s=.*{clock:.3f} lets both begin together"):
        join_pictures(samples, NAMES, TIMES)
    form = EmFormat(offset_s=clock)
    assert join_pictures(read_em_samples(tmp_path / "em.csv", form), NAMES, TIMES, form).samples.seen.all()


def test_readings_that_are_not_visible_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "em.csv"
    path.write_text("frame,x_mm,y_mm,z_mm\n0,200,0,0\n1,-3.697314E28,-3.697314E28,-3.697314E28\n2,201,0,0\n")
    assert join_pictures(read_em_samples(path), NAMES[:3]).said().startswith("2 of 3 pictures")
    path.write_text("frame,x_mm,y_mm,z_mm\n0,nan,nan,nan\n1,,,\n")
    with pytest.raises(InputError, match="not visible in any of the 3 pictures"):
        join_pictures(read_em_samples(path), NAMES[:3])


def test_names_join_exactly_before_loosely() -> None:
    names = ["a/1.png", "b/1.png", "003.jpg"]
    assert join_names(names, ["b/1.png", "1.png", "3", "4"]).tolist() == [1, -1, 2, -1]
    assert join_names(names, ["x/003.png"]).tolist() == [2]
    assert join_names(["0" * 5000 + "7"], ["7"]).tolist() == [0]


def test_pictures_of_one_name_in_different_folders_share_no_row() -> None:
    pictures = ["a/0001.png", "b/0001.png", "a/0002.png"]
    assert join_names(["0001.png", "0002.png"], pictures).tolist() == [-1, -1, 1]
    assert join_names(["a/0001.png", "0002"], pictures).tolist() == [0, -1, 1]
    assert join_names(["0001.png"], ["a/0001.png", "a/0001.png"]).tolist() == [0, 0]  # one picture, named twice


def test_given_logs_of_public_complaints(cases: Path) -> None:
    """24 pictures at 10 a second; P.npy holds the true positions."""
    truth = np.load(cases / "10-em-log-that-numbers-its-own-frames" / "P.npy")
    for name in ("em_t", "em_frame", "em_frame_ndi"):
        samples = read_em_samples(cases / "10-em-log-that-numbers-its-own-frames" / f"{name}.csv")
        joined = join_pictures(samples, NAMES, TIMES)
        assert joined.said().startswith("24 of 24 pictures have an EM reading (by time")
        np.testing.assert_allclose(joined.samples.position_mm, truth, atol=0.2)
    folder = cases / "11-em-log-that-fits-no-picture"
    for name, match in (
        ("em_ms", "em_time_unit=ms"),
        ("em_dc", "decimal commas"),
        ("em_blank_t", "blank in all 93 rows"),
    ):
        with pytest.raises(InputError, match=match):
            join_pictures(read_em_samples(folder / f"{name}.csv"), NAMES, TIMES)
    huge = read_em_samples(folder / "em_huge.csv")
    said = join_pictures(huge, NAMES, TIMES).said()
    assert not said.startswith("24 of 24")
    assert np.nanmax(np.abs(huge.position_mm)) < 1000


def test_frames_from_1_of_pictures_from_0_are_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "em.csv"
    path.write_text("frame,x_mm,y_mm,z_mm\n" + "\n".join(f"{i + 1},{100 + i},{20 - i},7" for i in range(12)))
    names = [f"{i:05d}" for i in range(12)]
    with pytest.raises(InputError, match="counts its frames from 1 to 12, the pictures are counted from 0 to 11"):
        join_pictures(read_em_samples(path), names)
    form = EmFormat(join="frame")
    assert "11 of 12 pictures" in join_pictures(read_em_samples(path, form), names, form=form).said()


def test_a_clock_that_jumps_back_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "em.csv"
    path.write_text("t_s,x_mm,y_mm,z_mm\n" + "\n".join(f"{i % 6 / 10},{100 + i},{20 - i},7" for i in range(12)))
    with pytest.raises(
        InputError, match=r"jumps back from 0\.500 to 0\.000 s between its lines 7 to 8: two recordings in one file"
    ):
        join_pictures(read_em_samples(path), [f"{i:05d}" for i in range(12)], np.arange(12) / 10)
