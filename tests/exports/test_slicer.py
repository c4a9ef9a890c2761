"""Slicer's files: markups come back as they went, and ITK's own reader takes the transform the way it is meant."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.exports import calyx_markup, lps_from_kidney, path_markups, point_markup, write_markups, write_tfm
from ursnav_torch.geometry import T_RAS_LPS, apply, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import calyces_from_markups, curves_of, points_of, read_markups


@pytest.mark.parametrize("frame", ["lps", "ras"])
def test_calyces_come_back_in_the_kidney_frame_whichever_it_is(frame: str, phantom: Kidney, tmp_path: Path) -> None:
    T = lps_from_kidney(frame)
    write_markups(tmp_path / "c.mrk.json", [calyx_markup(phantom, T)])
    calyces, pelvis = calyces_from_markups(read_markups(tmp_path / "c.mrk.json"), np.linalg.inv(T), "c")
    assert [c.name for c in calyces] == [c.name for c in phantom.calyces]
    np.testing.assert_allclose([c.tip_mm for c in calyces], phantom.tips_mm, atol=1e-5)
    np.testing.assert_allclose(pelvis, phantom.pelvis_mm, atol=1e-5)


def test_convention_the_file_says_lps_and_holds_lps(tmp_path: Path) -> None:
    """From RAS to LPS a point is turned half around about z."""
    write_markups(tmp_path / "p.mrk.json", [point_markup(["a"], np.array([[1.0, 2.0, 3.0]]), lps_from_kidney("ras"))])
    data = json.loads((tmp_path / "p.mrk.json").read_text(encoding="utf-8"))
    (markup,) = data["markups"]
    assert "markups-schema-v1" in data["@schema"]
    assert (markup["type"], markup["coordinateSystem"], markup["coordinateUnits"]) == ("Fiducial", "LPS", "mm")
    assert markup["controlPoints"][0]["position"] == [-1.0, -2.0, 3.0]


def test_a_path_is_a_curve_a_stretch_and_no_line_leads_over_a_gap(tmp_path: Path) -> None:
    T = np.tile(np.eye(4), (60, 1, 1))
    T[:, 0, 3] = np.arange(60) * 0.2
    T[20:30] = np.nan
    T[31] = np.nan  # leaves a single pose at 30, of which no curve can be made
    write_markups(tmp_path / "p.mrk.json", path_markups(T, np.eye(4)))
    first, second = curves_of(read_markups(tmp_path / "p.mrk.json"))
    np.testing.assert_allclose([first[0, 0], first[-1, 0], second[0, 0], second[-1, 0]], [0, 3.8, 6.4, 11.8])
    assert np.all(np.diff(first[:-1, 0]) >= 0.5 - 1e-9) and len(first) < 20


def test_a_track_without_a_path_is_refused() -> None:
    with pytest.raises(InputError, match="no two poses in a row"):
        path_markups(np.full((5, 4, 4), np.nan), np.eye(4))


def test_names_with_quotes_and_umlauts_survive(tmp_path: Path) -> None:
    names = ['mid "A"', "Kelch Ä", "x\\y"]
    write_markups(tmp_path / "p.mrk.json", [point_markup(names, np.eye(3), np.eye(4))])
    assert points_of(read_markups(tmp_path / "p.mrk.json"))[0] == tuple(names)


@pytest.mark.parametrize("frame", ["lps", "ras"])
@pytest.mark.parametrize("scale", [1.0, 1.8])
def test_convention_a_tfm_holds_the_resampling_direction_in_lps(frame: str, scale: float, tmp_path: Path) -> None:
    """ITK takes a point of the patient (LPS) to the EM frame; its inverse, seen in RAS, is Slicer's node."""
    sitk = pytest.importorskip("SimpleITK")
    T_kidney_em = transform_from(scale * Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix(), [4.0, -7.0, 11.0])
    T_lps_kidney = lps_from_kidney(frame)
    write_tfm(tmp_path / "r.tfm", T_kidney_em, T_lps_kidney)
    read = sitk.ReadTransform(str(tmp_path / "r.tfm"))
    p_em = np.array([10.0, 20.0, -30.0])
    p_lps = apply(T_lps_kidney @ T_kidney_em, p_em)
    in_em = np.array(read.TransformPoint(p_lps.tolist()))
    np.testing.assert_allclose(in_em, apply(T_RAS_LPS, p_em), atol=1e-8)
    # What Slicer makes of it: both spaces in RAS, and the inverse, "to parent".
    T_from_parent = np.eye(4)
    T_from_parent[:3, :3], T_from_parent[:3, 3] = np.reshape(read.GetParameters()[:9], (3, 3)), read.GetParameters()[9:]
    to_parent = np.linalg.inv(T_RAS_LPS @ T_from_parent @ T_RAS_LPS)
    np.testing.assert_allclose(apply(to_parent, p_em), apply(T_RAS_LPS, p_lps), atol=1e-8)


def test_a_frame_that_nobody_told_is_asked_for() -> None:
    with pytest.raises(InputError, match="LPS or RAS"):
        lps_from_kidney(None)
    with pytest.raises(InputError, match="'lsp'; accepted are lps and ras"):
        lps_from_kidney("lsp")
