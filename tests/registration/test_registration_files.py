"""Landmark files, and what touches and picks stand for."""

from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.registration import picked_points, read_landmarks, touched_points

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
