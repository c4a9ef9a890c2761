"""3D Slicer's markups are read in their own frame and turned into the kidney's."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import T_RAS_LPS
from ursnav_torch.kidney.ct import calyces_from_markups, curves_of, points_of, read_markups


def written(path: Path, points: dict[str, list[float]], **settings: Any) -> Path:
    controls = [{"id": str(i), "label": n, "position": p} for i, (n, p) in enumerate(points.items())]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": controls}
    path.write_text(json.dumps({"markups": [markup | settings]}), encoding="utf-8")
    return path


POINTS = {"upper": [1.0, 2.0, 3.0], "lower": [4.0, 5.0, 6.0], "Pelvis": [0.0, 1.0, 0.0]}


@pytest.mark.parametrize(("system", "sign"), [("LPS", 1), ("RAS", -1)])
def test_convention_points_come_out_in_lps(tmp_path: Path, system: str, sign: int) -> None:
    names, points = points_of(read_markups(written(tmp_path / "p.mrk.json", POINTS, coordinateSystem=system)))
    assert names == tuple(POINTS)
    np.testing.assert_allclose(points[0], [sign * 1, sign * 2, 3])


def test_points_name_calyces_and_pelvis_in_the_kidney_frame(tmp_path: Path) -> None:
    markups = read_markups(written(tmp_path / "p.mrk.json", POINTS))
    calyces, pelvis = calyces_from_markups(markups, T_RAS_LPS, "p")
    assert [c.name for c in calyces] == ["upper", "lower"]
    np.testing.assert_allclose(calyces[0].tip_mm, [-1, -2, 3])
    np.testing.assert_allclose(pelvis, [0, -1, 0])


def test_curves_are_told_from_points(tmp_path: Path) -> None:
    markups = read_markups(written(tmp_path / "c.mrk.json", POINTS, type="Curve"))
    assert len(curves_of(markups)) == 1 and not points_of(markups)[0]
    with pytest.raises(InputError, match="names no calyx"):
        calyces_from_markups(markups, np.eye(4), "c")


def test_points_that_were_not_placed_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path / "p.mrk.json", POINTS)
    data = json.loads(path.read_text())
    data["markups"][0]["controlPoints"][1]["positionStatus"] = "undefined"
    path.write_text(json.dumps(data))
    assert points_of(read_markups(path))[0] == ("upper", "Pelvis")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "is not a markups file"),
        ("{}", "is not a markups file"),
        ('{"markups": []}', "holds no point"),
        ('{"markups": [{"coordinateSystem": "IJK", "controlPoints": []}]}', "save them in LPS or RAS"),
        ('{"markups": [{"coordinateUnits": "m", "controlPoints": []}]}', "save them in LPS or RAS and mm"),
    ],
)
def test_what_is_no_markup_is_refused(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "p.mrk.json").write_text(text)
    with pytest.raises(InputError, match=match):
        read_markups(tmp_path / "p.mrk.json")
    with pytest.raises(InputError, match="There is no markups file"):
        read_markups(tmp_path / "none.json")


@pytest.mark.parametrize("name", ["", "lower"])
def test_names_must_be_there_and_differ(tmp_path: Path, name: str) -> None:
    path = written(tmp_path / "p.mrk.json", POINTS)
    data = json.loads(path.read_text())
    data["markups"][0]["controlPoints"][0]["label"] = name
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"is (used twice|empty); name each calyx once"):
        calyces_from_markups(read_markups(path), np.eye(4), "p")
