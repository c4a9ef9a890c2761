"""The runner segment, and a kidney from a CT all the way to a match."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.geometry import apply, look_along
from ursnav_torch.kidney import Kidney, load_mesh_kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.segmentation import Patient, place_kidney, read_scan, synthetic_ct, write_scan
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import load_vid

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")
FILES = ["calyces.csv", "centerline.csv", "labels.nii.gz", "lumen.stl", "preview.png", "segmentation.json"]


@pytest.fixture(scope="module")
def patient(phantom: Kidney) -> Patient:
    return place_kidney(phantom)


@pytest.fixture(scope="module")
def ct(patient: Patient, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ct") / "scan, ä=1 [x].nii.gz"
    write_scan(synthetic_ct([patient], size=(300, 280, 110)), path)
    return path


def test_the_folder_holds_all_that_is_needed(run: Any, ct: Path, patient: Patient, tmp_path: Path) -> None:
    points = [{"label": "A", "position": [1, 2, 3]}, {"label": "B", "position": [4, 5, 6]}]
    markups = {
        "markups": [{"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": "mm", "controlPoints": points}]
    }
    (tmp_path / "l.mrk.json").write_text(json.dumps(markups))
    done = run("segment", f"kidney.path={ct}", "out=mine", f"landmarks={tmp_path}/l.mrk.json", "kidney.frame=ras")
    assert (done.code, done.err) == (0, "") and "preview.png" in done.out
    out = Path("mine")
    assert sorted(p.name for p in out.iterdir()) == sorted([*FILES, "landmarks.csv"])
    assert b"SPACE=RAS" in (out / "lumen.stl").read_bytes()[:80]
    labels, scan = read_scan(out / "labels.nii.gz"), read_scan(ct)
    np.testing.assert_allclose(labels.T_lps_voxel, scan.T_lps_voxel, atol=1e-4)
    assert scan.voxels[labels.voxels == 1].min() > 200 and set(np.unique(labels.voxels)) == {0, 1}
    about = json.loads((out / "segmentation.json").read_text(encoding="utf-8"))
    assert about["frame"] == "RAS" and about["surface_volume_ml"] == pytest.approx(about["volume_ml"], rel=0.05)
    landmarks = read_csv(out / "landmarks.csv", ["kidney_x_mm", "em_x_mm"], "landmarks")
    assert [float(landmarks[0][f"kidney_{k}_mm"]) for k in "xyz"] == [1, 2, 3] and landmarks[0]["em_x_mm"] == ""
    picture = cv2.imread(str(out / "preview.png"))
    assert picture is not None and picture.std() > 20
    kidney = load_mesh_kidney(out / "lumen.stl", out / "calyces.csv")
    assert len(kidney.calyces) == len(patient.tips_lps)


@pytest.mark.parametrize(
    ("overrides", "code", "says"),
    [
        (("kidney.path=none.nii",), 1, "There is no scan"),
        (("kidney.side=left",), 1, "No contrast-filled collecting system was found on the left side"),
        (("kidney.label=2",), 1, "is a CT and no label map"),
        (("landmarks=none.mrk.json",), 1, "There is no markups file"),
        (("kidney.calyces=none.csv",), 1, "There is no calyces file"),
        (("kidney=phantom",), 1, "kidney=ct"),
        (("kidney=mesh", "kidney.path=a.stl"), 1, "kidney=ct"),
        (("kidney.no_such=1",), 2, "no_such"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    run: Any, ct: Path, overrides: tuple[str, ...], code: int, says: str
) -> None:
    given = [] if any(o.startswith(("kidney.path", "kidney=")) for o in overrides) else [f"kidney.path={ct}"]
    done = run("segment", *given, "out=mine", *overrides)
    assert done.code == code and says in done.err and "Traceback" not in done.err, done.err
    assert not list(Path().iterdir()), "nothing half-written"


def test_results_are_not_replaced_unasked(run: Any, ct: Path) -> None:
    assert run("segment", f"kidney.path={ct}", "out=mine").code == 0
    done = run("segment", f"kidney.path={ct}", "out=mine")
    assert done.code == 1 and "exists already" in done.err


@pytest.mark.slow
def test_a_label_map_is_segmented_anew_to_the_same(run: Any, ct: Path, tmp_path: Path) -> None:
    run("segment", f"kidney.path={ct}", "out=first")
    done = run("segment", "kidney.path=first/labels.nii.gz", "kidney.label=1", "out=second")
    assert done.code == 0
    first, second = (read_scan(Path(n) / "labels.nii.gz") for n in ("first", "second"))
    np.testing.assert_array_equal(first.voxels, second.voxels)


@pytest.mark.slow
def test_from_ct_to_match(run: Any, ct: Path, patient: Patient, phantom: Kidney) -> None:
    """A VID of what the CT shows locates pictures of the kidney that was scanned."""
    done = run(
        "build_vid", "kidney=ct", f"kidney.path={ct}", "camera.width=128", "camera.height=128",
        "views.views_per_calyx=80", "views.passage_views=20", "calibrate=false", "workers=1", "out=vid",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    vid = load_vid("vid")
    assert vid.kidney.source == ct.name
    renderer = RaycastRenderer(patient.mesh, equidistant_camera(160.0, 128, 128))
    locate, right, errors = Localizer(vid).locate, 0, []
    nearest = np.linalg.norm(vid.kidney.tips_mm[None] - patient.tips_lps[:, None], axis=-1).argmin(axis=1)
    T_lps_phantom = _rigid(phantom, patient)
    for calyx in range(len(phantom.calyces)):
        path = phantom.centerline.path_to(calyx)
        points = apply(T_lps_phantom, phantom.centerline.points_mm[path])
        at = points[np.argmin(np.abs(np.linalg.norm(points - points[-1], axis=1) - 6.0))]
        T = look_along(at, patient.tips_lps[calyx] - at)
        found = locate(renderer.render(T).image)
        right += int(found.calyx == nearest[calyx])
        errors.append(float(np.linalg.norm(found.T_kidney_camera[:3, 3] - at)))
    assert right >= len(phantom.calyces) - 1 and np.median(errors) < 2.0


def _rigid(phantom: Kidney, patient: Patient) -> np.ndarray:
    """Phantom to LPS, from corresponding tips (a right kidney is placed without a mirror)."""
    a, b = phantom.tips_mm, patient.tips_lps
    M = np.linalg.lstsq(np.column_stack([a, np.ones(len(a))]), b, rcond=None)[0]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = M[:3].T, M[3]
    return T
