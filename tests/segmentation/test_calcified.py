"""Stones of a scan: told where they can be told from contrast, and said where they cannot."""

from pathlib import Path

import numpy as np
import pytest
from ct_scans import labels_of, small_ct, with_stone

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import T_RAS_LPS, apply
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import (
    BesideScan,
    CtKidney,
    Patient,
    Scan,
    SegmentationSettings,
    calcified_stones,
    scan_lumen,
    segment_scan,
    write_scan,
)
from ursnav_torch.stones import read_known_stones

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")


@pytest.fixture(scope="module")
def patient(phantom: Kidney) -> Patient:
    return small_ct(phantom, size=(2, 2, 2))[1]


@pytest.fixture(scope="module")
def plain(phantom: Kidney) -> Scan:
    """A scan before contrast."""
    return small_ct(phantom, contrast_hu=12.0, noise_hu=10.0)[0]


@pytest.fixture(scope="module")
def full(phantom: Kidney, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same patient's scan with contrast as dense as stones are."""
    path = tmp_path_factory.mktemp("ct") / "full.nii.gz"
    write_scan(small_ct(phantom)[0], path)
    return path


@pytest.fixture(scope="module")
def found(full: Path) -> CtKidney:
    return scan_lumen(full)


def near_tips(patient: Patient) -> np.ndarray:
    """(C, 3) places in the calyces, LPS."""
    middle = np.asarray(patient.mesh.centroid)
    way = middle - patient.tips_lps
    return np.asarray(patient.tips_lps + 2.5 * way / np.linalg.norm(way, axis=1, keepdims=True))


def test_stones_before_contrast_have_places_and_sizes(found: CtKidney, plain: Scan, patient: Patient) -> None:
    centers, sizes = near_tips(patient)[:3], (7.0, 5.0, 3.0)
    scan = plain
    for center, size in zip(centers, sizes, strict=True):
        scan = with_stone(scan, center, size, 1100.0)
    told = calcified_stones(found, scan)
    assert told.could_tell and len(told.stones) == 3
    for stone, center, size in zip(told.stones, centers, sizes, strict=True):
        assert np.linalg.norm(stone.center_mm - center) < 0.5
        assert stone.size_mm == pytest.approx(size, abs=0.6)
    assert told.sentence.startswith("3 stones in the scan: ") and "less dense than 31" in told.sentence


def test_what_is_not_at_the_collecting_system_is_none(found: CtKidney, plain: Scan, patient: Patient) -> None:
    far = patient.tips_lps[0] + 6.2 * (patient.tips_lps[0] - near_tips(patient)[0]) / 2.5
    assert not calcified_stones(found, with_stone(plain, far, 2.5, 1100.0)).stones
    told = calcified_stones(found, plain)
    assert not told.stones and told.could_tell and told.sentence.startswith("No stone seen; ")


def test_specks_are_no_stones(found: CtKidney, plain: Scan, patient: Patient) -> None:
    assert not calcified_stones(found, with_stone(plain, near_tips(patient)[1], 0.9, 1100.0)).stones


def test_contrast_as_dense_as_stones_hides_them_and_it_is_said(found: CtKidney) -> None:
    told = calcified_stones(found)
    assert not told.could_tell and not told.stones
    assert told.sentence.startswith("Stones cannot be told in ") and "the lumen is filled with" in told.sentence
    assert "unenhanced=" in told.sentence


def test_thin_contrast_does_not_hide_a_stone_of_calcium(phantom: Kidney, tmp_path: Path) -> None:
    thin, patient = small_ct(phantom, contrast_hu=450.0)
    center = near_tips(patient)[0]
    write_scan(with_stone(thin, center, 5.0, 1500.0), tmp_path / "thin.nii.gz")
    told = calcified_stones(scan_lumen(tmp_path / "thin.nii.gz"))
    assert told.could_tell and len(told.stones) == 1, told.sentence
    assert np.linalg.norm(told.stones[0].center_mm - center) < 0.7
    assert told.stones[0].size_mm == pytest.approx(5.0, abs=0.8)


def test_a_label_map_needs_a_scan_beside_it(plain: Scan, patient: Patient, tmp_path: Path) -> None:
    write_scan(labels_of(patient, plain), tmp_path / "labels.nii.gz")
    write_scan(with_stone(plain, near_tips(patient)[0], 5.0, 900.0), tmp_path / "plain.nii.gz")
    settings = SegmentationSettings(label=1, frame="ras")
    alone = segment_scan(tmp_path / "alone", tmp_path / "labels.nii.gz", settings)
    assert "a label map has no densities" in alone.stones.sentence and not (tmp_path / "alone/stones.csv").exists()
    beside = BesideScan(unenhanced=tmp_path / "plain.nii.gz")
    made = segment_scan(tmp_path / "mine", tmp_path / "labels.nii.gz", settings, beside)
    known = read_known_stones(tmp_path / "mine/stones.csv")
    assert [k.name for k in known] == ["S1"] and made.stones.could_tell
    assert np.linalg.norm(known[0].center_mm - apply(T_RAS_LPS, near_tips(patient)[0])) < 0.5


def test_labels_are_no_scan_before_contrast(plain: Scan, patient: Patient, full: Path, tmp_path: Path) -> None:
    write_scan(labels_of(patient, plain), tmp_path / "labels.nii.gz")
    with pytest.raises(InputError, match=r"labels\.nii\.gz is a label map; stones are told by density"):
        segment_scan(tmp_path / "mine", full, beside=BesideScan(unenhanced=tmp_path / "labels.nii.gz"))


def test_a_scan_that_does_not_show_the_kidney_is_said(found: CtKidney, plain: Scan) -> None:
    half = plain.part((slice(0, 300), slice(0, 300), slice(0, 40)))
    told = calcified_stones(found, half)
    assert not told.could_tell and "does not show this kidney" in told.sentence
