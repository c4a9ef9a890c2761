from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import (
    Calyx,
    Kidney,
    read_calyces,
    read_centerline,
    write_calyces,
    write_centerline,
)


def test_calyces_come_back(tmp_path: Path) -> None:
    calyces = (Calyx("upper, front", np.array([1.5, -2.25, 3.0]), "upper"), Calyx("Ä=b", np.zeros(3)))
    write_calyces(tmp_path / "c.csv", calyces, np.array([4.0, 5.0, 6.0]))
    back, pelvis = read_calyces(tmp_path / "c.csv")
    assert [(c.name, c.pole, c.tip_mm.tolist()) for c in back] == [(c.name, c.pole, c.tip_mm.tolist()) for c in calyces]
    assert pelvis is not None and pelvis.tolist() == [4.0, 5.0, 6.0]


def test_a_file_without_pelvis_with_byte_order_mark_and_more_columns(tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    path.write_text("calyx,note,x_mm,y_mm,z_mm\nA,hard to reach,1,2,3\n\n", encoding="utf-8-sig")
    calyces, pelvis = read_calyces(path)
    assert pelvis is None and calyces[0].tip_mm.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "has no rows"),
        ("calyx,x_mm,y_mm\nA,1,2\n", r"lacks the column\(s\) z_mm"),
        ("calyx,x_mm,y_mm,z_mm\nA,1,2,three\n", "line 2: z_mm is 'three', expected a finite number"),
        ("calyx,x_mm,y_mm,z_mm\nA,1,2\n", "line 2 has 3 cells, the header 4"),
        ("calyx,x_mm,y_mm,z_mm\nA,1,2,inf\n", "expected a finite number"),
        ("calyx,x_mm,y_mm,z_mm\nA,1,2,3\nA,1,2,4\n", "'A' is used twice"),
        ("calyx,x_mm,y_mm,z_mm\n ,1,2,3\n", "'' is empty"),
        ("calyx,x_mm,y_mm,z_mm\npelvis,1,2,3\n", "names no calyx"),
        ('calyx,x_mm,y_mm,z_mm\n"A\nB",1,2,3\n', r"c\.csv, line 2: A calyx cannot be called 'A\\nB'"),
    ],
)
def test_unusable_calyces_are_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "c.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        read_calyces(path)


def test_missing_and_binary_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no calyces file"):
        read_calyces(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="not readable as CSV"):
        read_calyces(tmp_path / "binary.csv")


def test_centerlines_come_back(tmp_path: Path, phantom: Kidney) -> None:
    names = [c.name for c in phantom.calyces]
    write_centerline(tmp_path / "t.csv", phantom.centerline, names)
    back = read_centerline(tmp_path / "t.csv", names)
    np.testing.assert_array_equal(back.parent, phantom.centerline.parent)
    np.testing.assert_array_equal(back.calyx, phantom.centerline.calyx)
    np.testing.assert_allclose(back.points_mm, phantom.centerline.points_mm, atol=1e-4)
    np.testing.assert_allclose(back.radius_mm, phantom.centerline.radius_mm, atol=1e-4)


def test_a_centerline_of_another_kidney_or_out_of_order_is_refused(tmp_path: Path, phantom: Kidney) -> None:
    names = [c.name for c in phantom.calyces]
    write_centerline(tmp_path / "t.csv", phantom.centerline, names)
    with pytest.raises(InputError, match=r"leads to calyces \['A'\]"):
        read_centerline(tmp_path / "t.csv", names[1:])
    lines = (tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "t.csv").write_text("\n".join([lines[0], *lines[:1:-1]]))
    with pytest.raises(InputError, match="not a tree"):
        read_centerline(tmp_path / "t.csv", names)
