"""Scans that are missing, damaged, mixed or too large are refused before anything is made of them."""

import gzip
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation import Scan, read_scan, write_dicom, write_scan

sitk = pytest.importorskip("SimpleITK", reason="the extra ct is not installed")


@pytest.fixture
def scan() -> Scan:
    voxels = np.random.default_rng(0).integers(-1000, 1000, (20, 24, 16)).astype(np.int16)
    T = np.diag([0.7, 0.8, 1.5, 1.0])
    T[:3, 3] = [-10, 5, 100]
    return Scan(voxels, T, "")


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.mha"])
def test_what_was_written_is_read(scan: Scan, tmp_path: Path, name: str) -> None:
    write_scan(scan, tmp_path / name)
    again = read_scan(tmp_path / name)
    np.testing.assert_array_equal(again.voxels, scan.voxels)
    np.testing.assert_allclose(again.T_lps_voxel, scan.T_lps_voxel, atol=1e-4)


def test_fractions_of_hounsfield_units_are_rounded(scan: Scan, tmp_path: Path) -> None:
    values = scan.voxels.astype(np.float32) + 0.3
    values[0, 0, 0] = np.nan
    write_scan(Scan(values, scan.T_lps_voxel, ""), tmp_path / "float.nrrd")
    with pytest.warns(UserWarning, match="1 voxels are no numbers"):
        again = read_scan(tmp_path / "float.nrrd")
    assert again.voxels[0, 0, 0] == -1024
    np.testing.assert_array_equal(again.voxels.ravel()[1:], scan.voxels.ravel()[1:])


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.mha"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.95])
def test_truncated_files_are_refused(scan: Scan, tmp_path: Path, name: str, share: float) -> None:
    write_scan(scan, tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError, match=r"truncated|cannot be read as a scan"):
        read_scan(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "match"),
    [("none.nii", "There is no scan"), ("a.png", "no format of scans"), ("hello.nii", "cannot be read as a scan")],
)
def test_what_is_no_scan_is_refused(tmp_path: Path, name: str, match: str) -> None:
    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "hello.nii").write_bytes(b"hello")
    with pytest.raises(InputError, match=match):
        read_scan(tmp_path / name)


def test_a_bomb_is_refused_before_memory_is_taken(scan: Scan, tmp_path: Path) -> None:
    """A header of 30000 x 30000 x 30000 voxels, packed, with nothing behind it."""
    write_scan(scan, tmp_path / "a.nii")
    header = bytearray((tmp_path / "a.nii").read_bytes()[:352])
    struct.pack_into("<4h", header, 40, 3, 30000, 30000, 30000)
    (tmp_path / "bomb.nii.gz").write_bytes(gzip.compress(bytes(header) + bytes(1 << 20)))
    lies = "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n"
    nrrd = f"NRRD0004\ntype: short\ndimension: 3\nsizes: 90000 90000 90000\n{lies}encoding: gzip\nendian: little\n\n"
    (tmp_path / "bomb.nrrd").write_bytes(nrrd.encode() + gzip.compress(b""))
    tracemalloc.start()
    for name in ("bomb.nii.gz", "bomb.nrrd"):
        with pytest.raises(InputError, match=r"declares .* million; at most 1000 million are read|cannot be read"):
            read_scan(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    write_scan(scan, tmp_path / "small.nii")
    with pytest.raises(InputError, match=r"declares 20 x 24 x 16 voxels"):
        read_scan(tmp_path / "small.nii", largest_voxels=1000)


def test_several_values_a_voxel_or_several_times_are_refused(tmp_path: Path) -> None:
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((8, 9, 10, 3), np.int16), isVector=True), str(tmp_path / "v.nrrd"))
    with pytest.raises(InputError, match="3 values a voxel; one scan in three dimensions is needed"):
        read_scan(tmp_path / "v.nrrd")
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 8, 9, 10), np.int16), isVector=False), str(tmp_path / "t.nii"))
    with pytest.raises(InputError, match="one scan in three dimensions is needed"):
        read_scan(tmp_path / "t.nii")


def test_a_header_without_true_spacing_is_refused(scan: Scan, tmp_path: Path) -> None:
    write_scan(Scan(scan.voxels, np.diag([0.0007, 0.0007, 0.001, 1.0]), ""), tmp_path / "meters.nrrd")
    with pytest.raises(InputError, match=r"has voxels of .* mm; accepted are 0.05 to 10 mm"):
        read_scan(tmp_path / "meters.nrrd")


def test_a_series_is_read_in_the_order_of_its_places(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    for k, path in enumerate(sorted(tmp_path.glob("*.dcm"))):
        path.rename(tmp_path / f"IM{(k * 7) % 16:03d}")
    again = read_scan(tmp_path)
    np.testing.assert_array_equal(again.voxels, scan.voxels)
    np.testing.assert_allclose(again.T_lps_voxel, scan.T_lps_voxel, atol=1e-4)


def test_missing_slices_are_refused(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path)
    (tmp_path / "slice_0007.dcm").unlink()
    (tmp_path / "slice_0008.dcm").unlink()
    with pytest.raises(InputError, match=r"lacks slices: 2 missing, the first after slice_0006.dcm at 109.0 mm"):
        read_scan(tmp_path)


def test_mixed_series_are_listed(scan: Scan, tmp_path: Path) -> None:
    write_dicom(scan, tmp_path, "1.2.3.1")
    for path in tmp_path.glob("slice*.dcm"):
        path.rename(tmp_path / f"a_{path.name}")
    write_dicom(scan, tmp_path, "1.2.3.2")
    with pytest.raises(InputError, match=r"holds 2 series: 1.2.3.1 \(CT 'synthetic urography', 16 slices\)"):
        read_scan(tmp_path)
    assert read_scan(tmp_path, series="1.2.3.2").voxels.shape == (20, 24, 16)
    with pytest.raises(InputError, match="has no series 7; it has"):
        read_scan(tmp_path, series="7")


def test_two_phases_in_one_series_are_refused(scan: Scan, tmp_path: Path) -> None:
    pydicom = pytest.importorskip("pydicom")
    write_dicom(scan, tmp_path)
    for path in tmp_path.glob("slice*.dcm"):
        later = pydicom.dcmread(path)
        later.SOPInstanceUID = later.file_meta.MediaStorageSOPInstanceUID = f"{later.SOPInstanceUID}.2"
        later.save_as(tmp_path / f"a_{path.name}")
    with pytest.raises(InputError, match="pairs of slices at the same place"):
        read_scan(tmp_path)


def test_slices_of_another_size_in_one_series_are_refused(scan: Scan, tmp_path: Path) -> None:
    write_dicom(Scan(scan.voxels[:12], scan.T_lps_voxel, ""), tmp_path)
    (tmp_path / "slice_0003.dcm").rename(tmp_path / "localizer.dcm")
    write_dicom(scan, tmp_path / "whole")
    (tmp_path / "whole" / "slice_0003.dcm").unlink()
    (tmp_path / "localizer.dcm").rename(tmp_path / "whole" / "localizer.dcm")
    with pytest.raises(InputError, match="mixes slices of 2 sizes"):
        read_scan(tmp_path / "whole")


def test_a_tilted_gantry_is_refused(scan: Scan, tmp_path: Path) -> None:
    tilted = scan.T_lps_voxel.copy()
    for k in range(16):
        T = tilted.copy()
        T[1, 3] += 0.5 * k
        T[2, 3] += 1.5 * k
        write_dicom(Scan(scan.voxels[..., k : k + 1], T, ""), tmp_path / "one")
        (tmp_path / "one" / "slice_0000.dcm").rename(tmp_path / f"s{k:02d}.dcm")
    (tmp_path / "one").rmdir()
    with pytest.raises(InputError, match="tilted gantry"):
        read_scan(tmp_path)


@pytest.mark.parametrize("name", ["slice_0005.dcm", "slice_0015.dcm"])
@pytest.mark.parametrize("lost", [8, 400, 900])
def test_truncated_slices_are_refused(scan: Scan, tmp_path: Path, name: str, lost: int) -> None:
    write_dicom(scan, tmp_path)
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:-lost])
    with pytest.raises(InputError, match=name):
        read_scan(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello"])
def test_a_folder_without_a_series_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "readme.txt").write_bytes(content)
    with pytest.raises(InputError, match="holds no DICOM series"):
        read_scan(tmp_path)
