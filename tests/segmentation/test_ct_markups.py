"""3D Slicer's markups are read in their own frame and turned into the kidney's."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import T_RAS_LPS
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.segmentation import calyces_from_markups, curves_of, points_of, read_markups
from ursnav_torch.segmentation.curves import with_curves


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


@pytest.mark.parametrize("units", ["mm", ["mm", "UCUM", "millimeter"], ["mm", "UCUM"], ["mm", "UCUM", "Millimeter"]])
def test_millimeters_may_be_coded_as_the_schema_allows(tmp_path: Path, units: Any) -> None:
    assert len(points_of(read_markups(written(tmp_path / "p.mrk.json", POINTS, coordinateUnits=units)))[1]) == 3


@pytest.mark.parametrize("units", ["cm", ["cm", "UCUM", "centimeter"], ["mm"], ["mm", "DCM", "millimeter"], None, {}])
def test_other_units_are_refused(tmp_path: Path, units: Any) -> None:
    with pytest.raises(InputError, match="are not understood; save them in LPS or RAS and mm"):
        read_markups(written(tmp_path / "p.mrk.json", POINTS, coordinateUnits=units))


def test_given_markups_with_ucum_units(cases: Path) -> None:
    names, points = points_of(read_markups(cases / "18-markups-ucum" / "ucum.mrk.json"))
    assert len(names) == len(points) == 6


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
    data = json.loads(path.read_text(encoding="utf-8"))
    data["markups"][0]["controlPoints"][1]["positionStatus"] = "undefined"
    path.write_text(json.dumps(data))
    assert points_of(read_markups(path))[0] == ("upper", "Pelvis")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "not readable JSON"),
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
    data = json.loads(path.read_text(encoding="utf-8"))
    data["markups"][0]["controlPoints"][0]["label"] = name
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"is (used twice|empty); name each calyx once"):
        calyces_from_markups(read_markups(path), np.eye(4), "p")


def test_curves_become_the_centerline(phantom: Kidney) -> None:
    """Curves along the ways that were found give a tree of the same ways, joined where they run together."""
    tree = phantom.centerline
    curves = [tree.points_mm[tree.path_to(c)][:: (1, -1)[c % 2]] for c in range(len(phantom.calyces))]
    drawn = with_curves(phantom, curves, "c").centerline
    assert drawn.parent[0] == -1 and np.all(drawn.parent[1:] < np.arange(1, len(drawn.parent)))
    for c, tip in enumerate(phantom.tips_mm):
        ways = [t.from_root_mm()[t.path_to(c)[-1]] for t in (tree, drawn)]
        assert ways[1] == pytest.approx(ways[0], rel=0.06)
        np.testing.assert_allclose(drawn.points_mm[drawn.path_to(c)[-1]], tip)
    assert (drawn.calyx == -1).sum() > 5, "the first part of the way is shared"
    assert LumenDistance.from_kidney(phantom).clearance_mm(drawn.points_mm).min() > 0


def test_curves_that_do_not_fit_are_refused(phantom: Kidney) -> None:
    tree = phantom.centerline
    curves = [tree.points_mm[tree.path_to(c)] for c in range(len(phantom.calyces))]
    with pytest.raises(InputError, match=r"c has no curve that ends within 6 mm of calyx [A-Z]"):
        with_curves(phantom, curves[:-1], "c")
    bent = [np.vstack([c[0], c.mean(axis=0) + 40.0, c[-1]]) for c in curves]
    with pytest.raises(InputError, match=r"c: the curves leave the lumen by up to"):
        with_curves(phantom, bent, "c")


@pytest.mark.parametrize("unsaid", ["coordinateSystem", "coordinateUnits"])
def test_what_markups_do_not_say_is_taken_by_the_formats_definition_and_said(tmp_path: Path, unsaid: str) -> None:
    path = written(tmp_path / "p.mrk.json", POINTS)
    data = json.loads(path.read_text(encoding="utf-8"))
    del data["markups"][0][unsaid]
    path.write_text(json.dumps(data))
    with pytest.warns(UserWarning, match=rf"p\.mrk\.json does not say its {unsaid}: .* LPS and mm are taken"):
        np.testing.assert_allclose(points_of(read_markups(path))[1], list(POINTS.values()))


def test_a_control_point_that_is_no_place_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "p.mrk.json", POINTS | {"third": [1.0, 2.0, "nan"]})
    with pytest.raises(InputError, match=r"p\.mrk\.json: control point 4 is at \[1\.0, 2\.0, nan\], which is no place"):
        read_markups(path)
