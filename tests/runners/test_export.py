"""`export`: what each format needs, what it writes, and what it refuses."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.columns import TRACK_COLUMNS
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.files import write_csv, write_json
from ursnav_torch.registration import register_landmarks
from ursnav_torch.segmentation import Scan, curves_of, read_markups, write_dicom, write_scan
from ursnav_torch.vid import Vid, pose_cells


@pytest.fixture
def track(vid: Vid, tmp_path: Path) -> Path:
    """The first views of the VID, seen long enough, as a track with its coverage."""
    T = vid.T_kidney_camera[:10]
    rows = [{"frame": i, "t_s": 0.1 * i, "state": "tracking", **p} for i, p in enumerate(pose_cells(T))]
    write_csv(tmp_path / "track.csv", TRACK_COLUMNS, rows)
    coverage = Coverage(vid.kidney, vid.camera, vid.lumen)
    for pose in T:
        for _ in range(2):
            coverage.add(pose, 0.25)
    write_json(tmp_path / "track.coverage.json", coverage.to_dict())
    return tmp_path / "track.csv"


@pytest.fixture
def series(vid: Vid, tmp_path: Path) -> Path:
    write_dicom(scan_of(vid), tmp_path / "ct")
    return tmp_path / "ct"


def scan_of(vid: Vid) -> Scan:
    T = np.eye(4)
    T[:3, 3] = np.floor(vid.kidney.mesh.bounds[0] - 5)
    size = np.ceil(np.ptp(vid.kidney.mesh.bounds, axis=0) + 10).astype(int)
    return Scan(np.zeros(size, np.int16), T, "ct")


def test_slicer_gets_all_there_is(run: Any, vid: Vid, track: Path, tmp_path: Path) -> None:
    em = np.random.default_rng(0).normal(size=(6, 3)) * 20
    register_landmarks(em, em + np.arange(3.0)).to_json(tmp_path / "em.json")
    columns = ("name", "kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    write_csv(tmp_path / "l.csv", columns, [dict(zip(columns, ("tip", *range(6)), strict=True))])
    done = run("export", "to=slicer", f"vid={vid.folder}", "frame=ras", f"track={track}",
               f"landmarks={tmp_path / 'l.csv'}", f"em_to_kidney={tmp_path / 'em.json'}", "out=s")  # fmt: skip
    assert (done.code, done.err) == (0, "")
    out = tmp_path / "caller's folder" / "s"
    assert sorted(p.name for p in out.iterdir()) == [
        "calyces.mrk.json", "em_to_kidney.tfm", "kidney.stl", "landmarks.mrk.json", "path.mrk.json"
    ]  # fmt: skip
    module = Path(__file__).parents[2] / "integrations/slicer/UrsnavLive/UrsnavLiveLib/exported.py"
    loads = re.findall(r'^    "(\S+)": "', module.read_text(encoding="utf-8"), re.M)
    assert {p.name for p in out.iterdir()} <= set(loads), "the module for Slicer loads every file"
    assert b"SPACE=RAS" in (out / "kidney.stl").read_bytes()[:80]
    (curve,) = curves_of(read_markups(out / "path.mrk.json"))
    np.testing.assert_allclose(curve[0], vid.T_kidney_camera[0, :3, 3] * [-1, -1, 1], atol=1e-3)
    assert read_markups(out / "landmarks.mrk.json")[0].names == ("tip",)


def test_dicom_gets_all_there_is(run: Any, vid: Vid, track: Path, series: Path, tmp_path: Path) -> None:
    pytest.importorskip("highdicom")
    picture = next((vid.folder / "images").rglob("*.png"))
    done = run("export", "to=dicom", f"vid={vid.folder}", "frame=lps", f"scan={series}", f"track={track}",
               f"pictures={picture}", "out=d")  # fmt: skip
    assert (done.code, done.err) == (0, "")
    names = sorted(p.name for p in (tmp_path / "caller's folder" / "d").iterdir())
    assert names == ["capture_0001.dcm", "fiducials.dcm", "inspected.seg.dcm", "lumen.seg.dcm"]


def test_the_segmentations_own_voxels_and_frame_are_taken(run: Any, vid: Vid, series: Path, tmp_path: Path) -> None:
    pytest.importorskip("highdicom")
    from seg_files import read_seg

    scan = scan_of(vid)
    scan.voxels[20:25, 10:14, 8:11] = 1
    (tmp_path / "k").mkdir()
    write_scan(scan, tmp_path / "k" / "labels.nii.gz")
    (tmp_path / "k" / "segmentation.json").write_text(json.dumps({"frame": "LPS"}))
    given = ("to=dicom", f"vid={vid.folder}", f"scan={series}", f"segmentation={tmp_path / 'k'}")
    assert run("export", *given, "out=d").code == 0
    (seg,) = read_seg(tmp_path / "caller's folder" / "d" / "lumen.seg.dcm")
    assert seg.voxels.sum() == 60
    refused = run("export", *given, "frame=ras", "out=e")
    assert refused.code == 1 and "says LPS; leave frame= out" in refused.err
    T_moved = scan.T_lps_voxel.copy()
    T_moved[0, 3] += 3.0
    write_scan(Scan(scan.voxels, T_moved, ""), tmp_path / "k" / "labels.nii.gz")
    assert "give the series that it was made from" in run("export", *given, "out=e").err


def test_tum_is_what_track_itself_would_write(run: Any, track: Path, tmp_path: Path) -> None:
    assert run("export", "to=tum", f"track={track}", "out=t.tum").code == 0
    lines = (tmp_path / "caller's folder" / "t.tum").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 10 and len(lines[0].split()) == 8


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (("to=nifti",), "to='nifti' is no format; accepted are slicer, dicom, mcap, tum"),
        (("to=tum",), "to=tum needs track="),
        (("to=mcap", "track=x.csv"), "to=mcap needs record="),
        (("to=tum", "track=x.csv", "record=s"), "has no use for record="),
        (("to=slicer", "vid={vid}"), "LPS or RAS"),
        (("to=slicer", "vid={vid}", "frame=xyz"), "'xyz'; accepted are lps and ras"),
        (("to=dicom", "vid={vid}", "frame=lps", "scan=nowhere"), "is no folder; scan="),
        (("to=mcap", "record=nowhere"), "is no recorded session"),
    ],
)
def test_what_is_missing_or_idle_is_said(run: Any, vid: Vid, overrides: tuple[str, ...], said: str) -> None:
    done = run("export", *(o.format(vid=vid.folder) for o in overrides), "out=o")
    assert done.code == 1 and said in done.err


def test_an_older_tracks_coverage_is_refused(run: Any, vid: Vid, track: Path, series: Path) -> None:
    pytest.importorskip("highdicom")
    path = track.with_suffix(".coverage.json")
    data = json.loads(path.read_text(encoding="utf-8"))
    given = ("to=dicom", f"vid={vid.folder}", "frame=lps", f"scan={series}", f"track={track}", "out=d")
    write_json(path, data | {"patches": data["patches"] + 1})
    assert "another kidney" in run("export", *given).err
    del data["seen_patches"]
    write_json(path, data)
    assert "does not say which patches of the wall were seen" in run("export", *given).err
