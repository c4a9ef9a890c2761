"""Landmark and EM files, and which reading belongs to which image."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.registration import join_names, picked_points, read_em_samples, read_landmarks, touched_points

LANDMARKS = "kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_landmarks_in_any_column_order_with_a_byte_order_mark(tmp_path: Path) -> None:
    text = "\ufeffem_x_mm,em_y_mm,em_z_mm,kidney_z_mm,kidney_y_mm,kidney_x_mm,note\n4, 5,6,3,2,1,hello\n"
    pairs = read_landmarks(write(tmp_path / "l.csv", text))
    np.testing.assert_array_equal(pairs.kidney_mm, [[1, 2, 3]])
    np.testing.assert_array_equal(pairs.em_mm, [[4, 5, 6]])
    assert pairs.em_axis is None


def test_landmarks_may_have_axes(tmp_path: Path) -> None:
    path = write(tmp_path / "l.csv", f"{LANDMARKS},em_dx,em_dy,em_dz\n1,2,3,4,5,6,0,0,2\n")
    pairs = read_landmarks(path)
    assert pairs.em_axis is not None
    np.testing.assert_allclose(touched_points(pairs.em_mm, pairs.em_axis, 4.5), [[4, 5, 10.5]])


def test_picks_are_put_out_along_the_normal() -> None:
    import trimesh

    box = trimesh.creation.box((10, 10, 10))
    np.testing.assert_allclose(picked_points([[6.0, 1, 1], [1, -4.9, 2]], box, 1.5), [[6.5, 1, 1], [1, -6.5, 2]])


def test_a_touch_without_axis_is_refused() -> None:
    with pytest.raises(InputError, match="axis is zero"):
        touched_points(np.zeros((1, 3)), np.zeros((1, 3)), 4.0)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a,b\n1,2\n", "lacks the column.*kidney_x_mm"),
        (f"{LANDMARKS}\n1,2,3,4,five,6\n", "line 2: em_y_mm is 'five'"),
    ],
)
def test_landmark_files_are_checked(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match):
        read_landmarks(write(tmp_path / "l.csv", text))


def test_em_samples_have_unit_axes_and_nan_where_blank(tmp_path: Path) -> None:
    text = "frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz\n0,0.0,1,2,3,0,0,2\n1,0.1,,,,,,\n2,0.2,4,5,6,3,0,4\n"
    samples = read_em_samples(write(tmp_path / "em.csv", text))
    np.testing.assert_allclose(samples.axis[[0, 2]], [[0, 0, 1], [0.6, 0, 0.8]])
    assert np.isnan(samples.position_mm[1]).all()
    assert samples.visible().key == ("0", "2")


def test_readings_are_joined_by_frame_number(tmp_path: Path) -> None:
    samples = read_em_samples(write(tmp_path / "em.csv", "frame,x_mm,y_mm,z_mm\n0,0,0,0\n12,12,0,0\n7,7,0,0\n"))
    joined = samples.for_images(["00012.png", "00007.png", "00099.png"])
    np.testing.assert_array_equal(joined.position_mm[:, 0], [12, 7, np.nan])


def test_readings_are_joined_by_the_nearest_time_where_names_say_nothing(tmp_path: Path) -> None:
    samples = read_em_samples(write(tmp_path / "em.csv", "t_s,x_mm,y_mm,z_mm\n0.0,0,0,0\n0.1,1,0,0\n0.2,2,0,0\n"))
    joined = samples.for_images(["a.png", "b.png", "c.png"], t_s=[0.19, 0.04, 5.0])
    np.testing.assert_array_equal(joined.position_mm[:, 0], [2, 0, np.nan])
    with pytest.raises(InputError, match="No EM reading belongs to any"):
        samples.for_images(["a.png"])


def test_names_join_exactly_before_loosely() -> None:
    names = ["a/1.png", "b/1.png", "003.jpg"]
    assert join_names(names, ["b/1.png", "1.png", "3", "x/003.png", "4"]).tolist() == [1, -1, 2, 2, -1]


def test_an_empty_em_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"EM file .* has no rows"):
        read_em_samples(write(tmp_path / "em.csv", "frame,x_mm,y_mm,z_mm\n"))
