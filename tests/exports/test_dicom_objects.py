"""SEG, Spatial Fiducials and Secondary Capture: read by pydicom and highdicom, judged by dicom3tools' dciodvfy."""

import shutil
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from ct_series import Ct
from scipy import ndimage
from seg_files import read_seg

from ursnav_torch.errors import InputError
from ursnav_torch.exports import (
    LabeledMask,
    calyx_markup,
    inspected_wall,
    mask_of_mesh,
    point_markup,
    read_study,
    write_capture,
    write_fiducials,
    write_seg,
)
from ursnav_torch.geometry import apply
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import Scan, lumen_surface, write_dicom, write_stl
from ursnav_torch.segmentation.labels import label_counts, lumen_of_label

pydicom = pytest.importorskip("pydicom")

#: The standard has had a frame of reference in Secondary Capture for long (PS3.3, A.8.1.3: C), dciodvfy of 2022 not.
NEWER = ("FrameOfReferenceUID(0020,0052)> - Attribute is not", "PositionReferenceIndicator(0020,1040)> - Attribute is")


def complaints(path: Path) -> list[str]:
    """What dciodvfy says against a file; nothing where it is not installed (Debian: dicom3tools)."""
    if shutil.which("dciodvfy") is None:
        return []
    said = subprocess.run(["dciodvfy", "-new", str(path)], capture_output=True, text=True).stderr.splitlines()
    assert any(not line.startswith(("Warning", "Error")) for line in said), "it knows the kind of object"
    return [s for s in said if s.startswith(("Warning", "Error")) and not any(text in s for text in NEWER)]


def test_another_program_judges_the_objects() -> None:
    if shutil.which("dciodvfy") is None:
        pytest.skip("dciodvfy is not installed (Debian: dicom3tools): only pydicom and highdicom read the objects")


def opened(path: Path, ct: Ct) -> Any:
    """The data set, opened without a warning, checked for what all objects share with the CT."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data, source = pydicom.dcmread(path), ct.study.sources[0]
        data.walk(lambda _, element: element.value)  # every value is read
    assert complaints(path) == []
    assert (data.StudyInstanceUID, data.PatientID) == (source.StudyInstanceUID, source.PatientID)
    assert data.SeriesInstanceUID != source.SeriesInstanceUID
    return data


def test_a_study_lies_where_its_scan_lies(ct: Ct) -> None:
    assert ct.study.shape == ct.scan.voxels.shape
    np.testing.assert_allclose(ct.study.T_lps_voxel, ct.scan.T_lps_voxel, atol=1e-5)


def test_a_mesh_fills_the_voxels_whose_centers_it_holds(ct: Ct, phantom: Kidney) -> None:
    mask = mask_of_mesh(phantom.mesh, ct.study)
    rng = np.random.default_rng(0)
    some = rng.integers(0, ct.study.shape, (2000, 3))
    some = np.vstack([some, np.argwhere(mask)[::20], np.argwhere(ndimage.binary_dilation(mask) & ~mask)[::20]])
    inside = phantom.mesh.contains(ct.scan.to_lps(some))
    assert 0.05 < inside.mean() < 0.6
    np.testing.assert_array_equal(mask[tuple(some.T)], inside)


def test_a_mesh_beside_the_scan_is_refused(ct: Ct, phantom: Kidney) -> None:
    away = phantom.mesh.copy().apply_translation([30.0, 0.0, 0.0])
    with pytest.raises(InputError, match="does not lie within the scan"):
        mask_of_mesh(away, ct.study)


def test_a_seg_is_read_by_others_at_its_place(ct: Ct, phantom: Kidney, tmp_path: Path) -> None:
    mask = mask_of_mesh(phantom.mesh, ct.study)
    write_seg(tmp_path / "s.dcm", [LabeledMask("Lumen", mask)], ct.study, "lumen")
    data = opened(tmp_path / "s.dcm", ct)
    assert data.Modality == "SEG" and data.FrameOfReferenceUID == ct.study.frame_of_reference
    # pydicom alone: a frame, its own place and its pixels, against the mask at those places.
    frame = data.PerFrameFunctionalGroupsSequence[10]
    x, y = np.reshape(
        data.SharedFunctionalGroupsSequence[0].PlaneOrientationSequence[0].ImageOrientationPatient, (2, 3)
    )
    row, column = data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].PixelSpacing
    start = np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float)
    j, i = np.nonzero(data.pixel_array[10])
    points = start + np.outer(i * float(column), np.array(x, float)) + np.outer(j * float(row), np.array(y, float))
    at = np.rint(ct.scan.to_voxel(points)).astype(int)
    assert len(at) > 10 and mask[tuple(at.T)].all() and len(at) == mask[:, :, at[0, 2]].sum()
    (scan,) = read_seg(tmp_path / "s.dcm")
    assert scan.source == "Lumen"
    np.testing.assert_allclose(np.sort(scan.to_lps(np.argwhere(scan.voxels)), axis=0),
                               np.sort(ct.scan.to_lps(np.argwhere(mask)), axis=0), atol=1e-3)  # fmt: skip


def test_seg_to_stl_to_seg_keeps_the_surface_within_a_voxel(ct: Ct, phantom: Kidney, tmp_path: Path) -> None:
    write_seg(tmp_path / "a.dcm", [LabeledMask("Lumen", mask_of_mesh(phantom.mesh, ct.study))], ct.study, "lumen")
    (scan,) = read_seg(tmp_path / "a.dcm")
    write_stl(tmp_path / "a.stl", lumen_surface(lumen_of_label(scan, label_counts(scan), 1, None), 60_000), "lps")
    mesh = trimesh.load_mesh(tmp_path / "a.stl", process=True)
    write_seg(tmp_path / "b.dcm", [LabeledMask("Lumen", mask_of_mesh(mesh, ct.study))], ct.study, "lumen")
    a, b = (on_grid(read_seg(tmp_path / name)[0], ct) for name in ("a.dcm", "b.dcm"))
    box = np.ones((3, 3, 3), bool)
    assert not np.any(b & ~ndimage.binary_dilation(a, box)) and not np.any(ndimage.binary_erosion(a, box) & ~b)
    assert np.mean(a[a | b] != b[a | b]) < 0.1
    assert b.sum() == pytest.approx(a.sum(), rel=0.02)


def on_grid(scan: Scan, ct: Ct) -> np.ndarray:
    mask = np.zeros(ct.study.shape, bool)
    at = np.rint(ct.scan.to_voxel(scan.to_lps(np.argwhere(scan.voxels)))).astype(int)
    mask[tuple(at.T)] = True
    return mask


def test_what_was_inspected_is_the_wall_next_to_the_patches_seen(ct: Ct, phantom: Kidney, tmp_path: Path) -> None:
    mask, patches = mask_of_mesh(phantom.mesh, ct.study), np.asarray(phantom.mesh.triangles_center)[::10]
    low = np.flatnonzero(patches[:, 2] < -5)
    write_seg(tmp_path / "i.dcm", inspected_wall(mask, patches, low.tolist(), ct.study), ct.study, "inspected")
    opened(tmp_path / "i.dcm", ct)
    seen, unseen = read_seg(tmp_path / "i.dcm")
    assert (seen.source, unseen.source) == ("Inspected wall", "Wall not inspected")
    low_mm, high_mm = (s.to_lps(np.argwhere(s.voxels))[:, 2] for s in (seen, unseen))
    assert low_mm.max() < -3 and high_mm.min() > -7
    wall = on_grid(seen, ct) | on_grid(unseen, ct)
    np.testing.assert_array_equal(wall, mask & ~ndimage.binary_erosion(mask))
    assert not np.any(on_grid(seen, ct) & on_grid(unseen, ct))


def test_nothing_seen_is_one_segment_and_a_foreign_patch_is_refused(ct: Ct, phantom: Kidney) -> None:
    mask, patches = mask_of_mesh(phantom.mesh, ct.study), np.asarray(phantom.mesh.triangles_center)[::10]
    assert [s.label for s in inspected_wall(mask, patches, [], ct.study)] == ["Wall not inspected"]
    with pytest.raises(InputError, match="of another kidney"):
        inspected_wall(mask, patches, [len(patches)], ct.study)


@pytest.mark.parametrize("mask", [np.zeros((4, 4, 4), bool), None])
def test_segments_that_cannot_be_are_refused(mask: np.ndarray | None, ct: Ct, tmp_path: Path) -> None:
    given = np.zeros(ct.study.shape, bool) if mask is None else mask
    with pytest.raises(
        InputError, match="has no voxel" if mask is None else "4 x 4 x 4 voxels, the scan 100 x 90 x 80"
    ):
        write_seg(tmp_path / "s.dcm", [LabeledMask("x", given)], ct.study, "lumen")
    assert not list(tmp_path.iterdir())


def test_fiducials_hold_every_point_in_the_cts_frame(ct: Ct, phantom: Kidney, tmp_path: Path) -> None:
    landmarks = point_markup(["Landmark number one", "Landmark number two", ""], np.eye(3) * 5, np.eye(4))
    lists = {"calyces": calyx_markup(phantom, np.eye(4)), "landmarks": landmarks}
    write_fiducials(tmp_path / "f.dcm", lists, ct.study)
    data = opened(tmp_path / "f.dcm", ct)
    assert data.Modality == "FID"
    for fiducials, markup in zip(data.FiducialSetSequence, lists.values(), strict=True):
        assert fiducials.FrameOfReferenceUID == ct.study.frame_of_reference
        items = fiducials.FiducialSequence
        assert [i.FiducialDescription for i in items] == [name or "point" for name in markup.names]
        assert len({i.FiducialIdentifier for i in items}) == len(items), "told apart though shortened"
        np.testing.assert_allclose([i.ContourData for i in items], markup.points_lps, atol=1e-3)


def test_no_point_is_refused(ct: Ct, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no point"):
        write_fiducials(tmp_path / "f.dcm", {"a": point_markup([], np.zeros((0, 3)), np.eye(4))}, ct.study)


def test_pictures_are_kept_pixel_by_pixel_in_the_right_colors(ct: Ct, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    blue, gray = np.zeros((30, 41, 3), np.uint8), rng.integers(0, 255, (21, 20), dtype=np.uint8)
    blue[..., 0] = 255  # OpenCV's order
    one, two = write_capture(tmp_path, [("blue.png", blue), ("gray.png", gray)], ct.study)
    first, second = opened(one, ct), opened(two, ct)
    np.testing.assert_array_equal(first.pixel_array, np.tile([0, 0, 255], (30, 41, 1)))
    np.testing.assert_array_equal(second.pixel_array, gray)
    assert first.SeriesInstanceUID == second.SeriesInstanceUID and first.SOPInstanceUID != second.SOPInstanceUID
    assert first.FrameOfReferenceUID == ct.study.frame_of_reference
    assert (first.ImageComments, second.InstanceNumber) == ("blue.png", 2)
    assert "ImagePositionPatient" not in first, "a page lies nowhere in the patient"


def test_an_enhanced_multiframe_ct_is_a_study_too(ct: Ct, phantom: Kidney, tmp_path: Path) -> None:
    from dicom_objects import enhanced_ct

    enhanced_ct(tmp_path / "e.dcm", ct.scan, list(range(ct.scan.voxels.shape[2]))[::-1])
    with pytest.raises(InputError, match="has no FrameOfReferenceUID"):
        read_study(tmp_path)
    data = pydicom.dcmread(tmp_path / "e.dcm")
    data.FrameOfReferenceUID = "1.2.3.4"
    data.save_as(tmp_path / "e.dcm")
    study = read_study(tmp_path)
    assert study.shape == ct.study.shape
    np.testing.assert_allclose(study.T_lps_voxel, ct.study.T_lps_voxel, atol=1e-5)


def test_a_series_without_identity_gets_blanks_and_no_inventions(ct: Ct, tmp_path: Path) -> None:
    write_dicom(replace(ct.scan, voxels=ct.scan.voxels[:, :, :5]), tmp_path / "ct")
    for path in (tmp_path / "ct").iterdir():
        data = pydicom.dcmread(path)
        del data.PatientID
        data.save_as(path)
    study = read_study(tmp_path / "ct")
    write_fiducials(tmp_path / "f.dcm", {"a": point_markup(["a"], np.ones((1, 3)), np.eye(4))}, study)
    assert pydicom.dcmread(tmp_path / "f.dcm").PatientID == ""


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no folder; scan= takes the folder"):
        read_study(tmp_path / "x")


def test_points_of_a_ras_kidney_are_turned(ct: Ct, tmp_path: Path) -> None:
    from ursnav_torch.exports import lps_from_kidney

    T = lps_from_kidney("ras")
    write_fiducials(tmp_path / "f.dcm", {"a": point_markup(["a"], np.array([[1.0, 2.0, 3.0]]), T)}, ct.study)
    item = pydicom.dcmread(tmp_path / "f.dcm").FiducialSetSequence[0].FiducialSequence[0]
    np.testing.assert_allclose(item.ContourData, apply(T, [1.0, 2.0, 3.0]))
