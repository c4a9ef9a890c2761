"""DICOM as archives give it: compressed, enhanced, with reports beside the slices, and truly truncated."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dicom_objects import enhanced_ct, presentation_state, report, secondary_capture

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation import Scan, read_scan, write_dicom
from ursnav_torch.segmentation.scans.dicom import is_whole

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")
pydicom = pytest.importorskip("pydicom", reason="the extra ct is not installed")


@pytest.fixture
def scan() -> Scan:
    voxels = np.random.default_rng(0).integers(-1000, 1000, (36, 40, 16)).astype(np.int16)
    T = np.diag([0.7, 0.8, 1.5, 1.0])
    T[:3, 3] = [-10, 5, 100]
    return Scan(voxels, T, "")


SYNTAXES = {"rle": "RLELossless", "JPEG 2000": "JPEG2000Lossless", "JPEG-LS": "JPEGLSLossless"}


def compress(folder: Path, how: str) -> None:
    """Write every slice again, compressed."""
    for path in sorted(folder.iterdir()):
        data = pydicom.dcmread(path)
        data.compress(getattr(pydicom.uid, SYNTAXES[how]))
        data.save_as(path)


@pytest.mark.parametrize("how", SYNTAXES)
def test_compressed_slices_are_read_and_their_end_is_checked(scan: Scan, tmp_path: Path, how: str) -> None:
    write_dicom(scan, tmp_path)
    compress(tmp_path, how)
    again = read_scan(tmp_path)
    np.testing.assert_array_equal(again.voxels, scan.voxels)
    np.testing.assert_allclose(again.T_lps_voxel, scan.T_lps_voxel, atol=1e-4)
    path = tmp_path / "slice_0003.dcm"
    assert is_whole(path)
    path.write_bytes(path.read_bytes()[:-40])
    assert not is_whole(path)
    with pytest.raises(InputError, match=r"slice_0003\.dcm.* truncated"):
        read_scan(tmp_path)


def test_truncated_plain_slices_are_refused(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    path = tmp_path / "slice_0003.dcm"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"slice_0003\.dcm.* truncated"):
        read_scan(tmp_path)


def test_reports_and_presentation_states_beside_the_slices_are_passed_over(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    report(tmp_path / "SR001")
    presentation_state(tmp_path / "PS001")
    (tmp_path / "README.txt").write_text("exported by somebody")
    np.testing.assert_array_equal(read_scan(tmp_path).voxels, scan.voxels)


def test_a_single_picture_beside_the_scan_is_passed_over_and_said(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    secondary_capture(tmp_path / "SC001")
    with pytest.warns(UserWarning, match=r"passed over beside the scan: .*OT 'dose page', 1 slices"):
        np.testing.assert_array_equal(read_scan(tmp_path).voxels, scan.voxels)


@pytest.mark.parametrize("order", ["rising", "falling", "mixed"])
def test_an_enhanced_file_is_read_frame_by_frame(scan: Scan, tmp_path: Path, order: str) -> None:
    frames = {"rising": range(16), "falling": range(15, -1, -1), "mixed": [(7 * k) % 16 for k in range(16)]}[order]
    enhanced_ct(tmp_path / "IM1", scan, list(frames))
    for path in (tmp_path, tmp_path / "IM1"):
        again = read_scan(path)
        np.testing.assert_array_equal(again.voxels, scan.voxels)
        np.testing.assert_allclose(again.T_lps_voxel, scan.T_lps_voxel, atol=1e-4)


def test_enhanced_files_that_are_no_single_stack_are_refused(scan: Scan, tmp_path: Path) -> None:
    enhanced_ct(tmp_path / "phases.dcm", scan, [*range(8), *range(8)])
    with pytest.raises(InputError, match="several frames at the same place"):
        read_scan(tmp_path / "phases.dcm")
    enhanced_ct(tmp_path / "gap.dcm", scan, [0, 1, 2, 3, 7, 8, 9])
    with pytest.raises(InputError, match="no even, straight stack"):
        read_scan(tmp_path / "gap.dcm")
    whole = (tmp_path / "gap.dcm").read_bytes()
    (tmp_path / "gap.dcm").write_bytes(whole[:-100])
    with pytest.raises(InputError, match="truncated"):
        read_scan(tmp_path / "gap.dcm")


def test_a_slice_alone_and_a_folder_of_reports_are_named(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path / "series")
    with pytest.raises(InputError, match="a single DICOM slice; give the folder"):
        read_scan(tmp_path / "series" / "slice_0001.dcm")
    report(tmp_path / "SR001")
    with pytest.raises(InputError, match="holds no DICOM series"):
        read_scan(tmp_path)


def test_given_series_of_public_complaints(cases: Path) -> None:
    control, rle = (read_scan(cases / "03-dicom-compressed" / name) for name in ("control", "rle"))
    np.testing.assert_array_equal(rle.voxels, control.voxels)
    np.testing.assert_array_equal(read_scan(cases / "04-dicom-report-beside" / "series").voxels, control.voxels)


def changed(folder: Path, scan: Scan, change: Callable[[Any, int], object]) -> Path:
    """The scan's series with every slice's tags changed, by the slice's number."""
    write_dicom(scan, folder)
    for number, path in enumerate(sorted(folder.iterdir())):
        data = pydicom.dcmread(path)
        change(data, number)
        data.save_as(path)
    return folder


@pytest.mark.parametrize(
    ("tag", "value", "reason"),
    [
        ("PixelSpacing", lambda n: [0.9, 0.9] if n == 7 else [0.8, 0.7], r"mixes pixel sizes: .*slice_0007\.dcm"),
        ("PatientID", lambda n: "AB"[n > 7], r"mixes slices of 2 patients \('A', 'B'\)"),
        ("FrameOfReferenceUID", lambda n: f"1.2.{3 + (n > 7)}", "mixes slices of 2 frames of reference"),
        ("ImageOrientationPatient", lambda n: [2, 0, 0, 0, 2, 0], "not at right angles and of length 1"),
        ("ImageOrientationPatient", lambda n: [1, 0, 0, 0.5, 0.866, 0], "not at right angles and of length 1"),
        ("PhotometricInterpretation", lambda n: "MONOCHROME1", "shows high numbers dark"),
        ("ImageOrientationPatient", lambda n: None, r"how its slice lies \(ImageOrientationPatient is None\)"),
        ("PixelSpacing", lambda n: [0, 0.7], r"pixels of \[0\.0, 0\.7\] mm \(PixelSpacing\)"),
        ("RescaleSlope", lambda n: 0, r"scales its numbers by 0 \(RescaleSlope\)"),
    ],
)
def test_slices_that_are_not_of_one_scan_are_refused(
    scan: Scan, tmp_path: Path, tag: str, value: Callable[[int], object], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_scan(changed(tmp_path, scan, lambda data, n: setattr(data, tag, value(n))))


def test_what_a_series_leaves_open_is_said(scan: Scan, tmp_path: Path) -> None:
    for name, change, reason in (
        ("mr", lambda data, n: setattr(data, "Modality", "MR"), "is MR, not CT"),
        ("raw", lambda data, n: data.pop("RescaleIntercept"), r"Hounsfield units \(RescaleIntercept\)"),
        ("counts", lambda data, n: setattr(data, "RescaleType", "OD"), r"calls its numbers 'OD' \(RescaleType\)"),
        ("thin", lambda data, n: setattr(data, "SliceThickness", 0.6), "0.6 mm thick and 1.5 mm apart"),
        ("cm", lambda data, n: setattr(data, "SliceThickness", 15), "15 mm thick and 1.5 mm apart"),
    ):
        with pytest.warns(UserWarning, match=reason):
            read_scan(changed(tmp_path / name, scan, change))


def test_copies_of_slices_are_told_from_phases(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    shutil.copy(tmp_path / "slice_0005.dcm", tmp_path / "slice_0005 (1).dcm")
    with pytest.raises(InputError, match=r"has 1 slices twice, copies .*slice_0005.* and slice_0005.*Delete one"):
        read_scan(tmp_path)
    (tmp_path / "DICOMDIR").write_bytes(bytes(128) + b"DICM")
    with pytest.raises(InputError, match="is the list of a disc's files; give the folder"):
        read_scan(tmp_path / "DICOMDIR")
