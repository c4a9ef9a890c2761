"""What to segment: which side, which label, which point; and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from ct_scans import between, labels_of, small_ct

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import (
    CtKidney,
    Patient,
    Scan,
    SegmentationSettings,
    place_kidney,
    scan_lumen,
    synthetic_ct,
    write_scan,
)

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")


@pytest.fixture(scope="module")
def patients(phantom: Kidney) -> dict[str, Patient]:
    return {side: place_kidney(phantom, side) for side in ("left", "right")}


@pytest.fixture(scope="module")
def both(patients: dict[str, Patient], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan of both kidneys."""
    path = tmp_path_factory.mktemp("both") / "both.nii.gz"
    write_scan(synthetic_ct(list(patients.values()), spacing_mm=(0.9, 0.9, 1.0), size=(360, 240, 115)), path)
    return path


def lumen(path: Path, **choices: object) -> CtKidney:
    return scan_lumen(path, SegmentationSettings(**choices))  # type: ignore[arg-type]


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_side_is_the_patients(both: Path, patients: dict[str, Patient], side: str) -> None:
    mesh = lumen(both, side=side).mesh
    assert between(mesh, patients[side].mesh).mean() < 0.5
    assert (mesh.centroid[0] > 0) == (side == "left"), "LPS: x points to the patient's left"


def test_two_kidneys_and_no_side_are_refused(both: Path) -> None:
    with pytest.raises(InputError, match=r"two collecting systems: left .* mL and right .* mL"):
        lumen(both)


def test_a_seed_takes_what_it_lies_in(both: Path, patients: dict[str, Patient]) -> None:
    seed = patients["left"].tips_lps[0].tolist()
    assert between(lumen(both, seed_mm=seed).mesh, patients["left"].mesh).mean() < 0.5


@pytest.mark.parametrize(
    ("choices", "match"),
    [
        ({"seed_mm": [0.0, -40.0, 0.0]}, r"is not in contrast: .* HU is the most within 4 mm, 240 HU are needed"),
        ({"seed_mm": [0.0, 900.0, 0.0]}, r"lies outside both.nii.gz, which reaches from"),
        ({"seed_mm": [1.0, 2.0]}, r"must be a point \[x, y, z\]"),
        ({"seed_mm": [0.0, 68.0, -6.0]}, r"is no collecting system: .* It may be bone"),
        ({"side": "up"}, r"kidney.side is 'up'; accepted are left, right and null"),
        ({"frame": "ijk"}, r"kidney.frame is 'ijk'"),
        ({"faces": 10}, r"kidney.faces is 10"),
        ({"label": 3}, r"is a CT and no label map"),
    ],
)
def test_choices_that_fit_nothing_are_refused(both: Path, choices: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        lumen(both, **choices)


def test_bone_is_never_taken(phantom: Kidney, tmp_path: Path) -> None:
    """A scan before the contrast is excreted has bone as its only dense parts."""
    scan, _ = small_ct(phantom, spacing_mm=(1.0, 1.0, 1.5), size=(330, 220, 70), contrast_hu=12.0)
    write_scan(scan, tmp_path / "native.nii.gz")
    for side in (None, "left", "right"):
        with pytest.raises(InputError, match=r"No contrast-filled collecting system was found .* excretory phase"):
            lumen(tmp_path / "native.nii.gz", side=side)


@pytest.mark.parametrize("value", [0, -1000, 40])
def test_a_ct_of_nothing_is_refused(tmp_path: Path, value: int) -> None:
    voxels = np.full((60, 60, 40), value, np.int16)
    write_scan(Scan(voxels, np.eye(4), ""), tmp_path / "nothing.nii")
    with pytest.raises(InputError, match=r"shows no body: values from"):
        lumen(tmp_path / "nothing.nii")


def test_labels_are_chosen_by_number(patients: dict[str, Patient], tmp_path: Path) -> None:
    scan = Scan(np.zeros((200, 160, 90), np.int16), np.diag([1.0, 1.0, 1.2, 1.0]), "")
    scan.T_lps_voxel[:3, 3] = [-100, -70, -50]
    labels = labels_of(patients["right"], scan, 4)
    labels.voxels[labels_of(patients["left"], scan).voxels > 0] = 9
    write_scan(labels, tmp_path / "labels.nii.gz")
    assert between(lumen(tmp_path / "labels.nii.gz", label=4).mesh, patients["right"].mesh).mean() < 0.5
    assert lumen(tmp_path / "labels.nii.gz", label="9").mesh.centroid[0] > 0
    with pytest.raises(InputError, match=r"has several labels: 4, 9"):
        lumen(tmp_path / "labels.nii.gz")
    with pytest.raises(InputError, match=r"has no label 5; it has 4, 9"):
        lumen(tmp_path / "labels.nii.gz", label=5)
    with pytest.raises(InputError, match=r"has no label 'calyces'"):
        lumen(tmp_path / "labels.nii.gz", label="calyces")
    labels.voxels[labels.voxels > 0] = 1
    write_scan(labels, tmp_path / "one.nii.gz")
    with pytest.raises(InputError, match="consists of 2 pieces"):
        lumen(tmp_path / "one.nii.gz")
    assert lumen(tmp_path / "one.nii.gz", side="left").mesh.centroid[0] > 0
    labels.voxels[...] = 0
    write_scan(labels, tmp_path / "empty.nii.gz")
    with pytest.raises(InputError, match=r"is empty: no voxel carries a label|shows no body"):
        lumen(tmp_path / "empty.nii.gz", label=1)
