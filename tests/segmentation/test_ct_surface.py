"""A CT of a kidney of known shape gives that shape back, wherever and however it was stored."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from ct_scans import between, flipped, labels_of, small_ct, turned
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import T_RAS_LPS, apply, transform_from
from ursnav_torch.kidney import Kidney, LumenDistance, load_mesh_kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.segmentation import (
    CtKidney,
    Patient,
    Scan,
    SegmentationSettings,
    load_ct_kidney,
    read_scan,
    scan_lumen,
    write_dicom,
    write_scan,
    write_stl,
)

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")
OBLIQUE = Rotation.from_rotvec([0.15, -0.2, 0.25]).as_matrix()


@pytest.fixture(scope="module")
def truth(phantom: Kidney) -> tuple[Scan, Patient]:
    return small_ct(phantom)


@pytest.fixture(scope="module")
def folder(truth: tuple[Scan, Patient], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scans, ä [1]")
    write_scan(truth[0], folder / "straight.nii.gz")
    write_dicom(truth[0], folder / "series")
    return folder


@pytest.fixture(scope="module")
def straight(folder: Path) -> CtKidney:
    return lumen(folder / "straight.nii.gz")


def lumen(path: Path, frame: str = "lps", label: int | None = None) -> CtKidney:
    return scan_lumen(path, SegmentationSettings(label=label, frame=frame))


def check_true(mesh: trimesh.Trimesh, patient: Patient) -> None:
    distance = between(mesh, patient.mesh)
    assert distance.mean() < 0.5 and np.quantile(distance, 0.95) < 1.5
    assert mesh.volume == pytest.approx(patient.mesh.volume, rel=0.05)
    assert mesh.is_watertight and mesh.volume > 0
    assert np.all(LumenGrid.from_mesh(mesh, 0.5).clearance_mm(patient.tips_lps) > 0), "a calyx is missing"


def test_the_surface_is_the_true_one(straight: CtKidney, truth: tuple[Scan, Patient]) -> None:
    check_true(straight.mesh, truth[1])


def test_every_calyx_is_found_and_named_with_its_pole(folder: Path, truth: tuple[Scan, Patient]) -> None:
    kidney = load_ct_kidney(folder / "straight.nii.gz", faces=20_000)
    apart = np.linalg.norm(kidney.tips_mm[None] - truth[1].tips_lps[:, None], axis=-1).min(axis=1)
    assert apart.max() < 5 and {c.pole for c in kidney.calyces} >= {"upper", "lower"}
    upper = [c.tip_mm[2] for c in kidney.calyces if c.pole == "upper"]
    assert min(upper) > max(c.tip_mm[2] for c in kidney.calyces if c.pole == "lower"), "the head is at +z"
    assert LumenDistance.from_kidney(kidney).clearance_mm(kidney.pelvis_mm) > 1


def test_files_keep_where_their_voxels_lie(folder: Path, truth: tuple[Scan, Patient]) -> None:
    for name in ("straight.nii.gz", "series"):
        scan = read_scan(folder / name)
        np.testing.assert_allclose(scan.T_lps_voxel, truth[0].T_lps_voxel, atol=1e-3)
        np.testing.assert_array_equal(scan.voxels, truth[0].voxels)


def test_a_dicom_series_gives_the_same_surface(folder: Path, straight: CtKidney) -> None:
    assert between(lumen(folder / "series").mesh, straight.mesh).max() < 0.1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_flipped_axes_give_the_same_surface(
    folder: Path, truth: tuple[Scan, Patient], straight: CtKidney, axis: int
) -> None:
    write_scan(flipped(truth[0], axis), folder / "flipped.nrrd")
    mesh = lumen(folder / "flipped.nrrd").mesh
    assert mesh.volume > 0 and between(mesh, straight.mesh).max() < 0.1


def test_an_oblique_scan_comes_out_undistorted(folder: Path, phantom: Kidney, straight: CtKidney) -> None:
    scan, patient = small_ct(phantom, direction=OBLIQUE)
    write_scan(scan, folder / "oblique.nii.gz")
    mesh = lumen(folder / "oblique.nii.gz").mesh
    check_true(mesh, patient)
    assert between(mesh, straight.mesh).mean() < 0.1


def test_a_turned_header_turns_the_surface(folder: Path, truth: tuple[Scan, Patient]) -> None:
    scan, patient = truth
    T = transform_from(OBLIQUE, [10, -20, 30])
    labels = labels_of(patient, scan)
    write_scan(labels, folder / "labels.nii.gz")
    write_scan(turned(labels, T), folder / "labels_turned.nii.gz")
    mesh, other = lumen(folder / "labels.nii.gz").mesh, lumen(folder / "labels_turned.nii.gz").mesh
    np.testing.assert_allclose(apply(T, mesh.vertices), other.vertices, atol=0.1)


def test_a_label_map_gives_the_shape_and_volume_of_its_label(folder: Path, truth: tuple[Scan, Patient]) -> None:
    labels = labels_of(truth[1], truth[0], label=7)
    write_scan(labels, folder / "seven.nrrd")
    found = lumen(folder / "seven.nrrd", label=7)
    check_true(found.mesh, truth[1])
    voxel = np.prod(labels.spacing_mm)
    assert found.mesh.volume == pytest.approx((labels.voxels == 7).sum() * voxel, rel=0.03)


def test_thick_slices_come_out_without_steps(folder: Path, phantom: Kidney) -> None:
    scan, patient = small_ct(phantom, spacing_mm=(0.7, 0.7, 2.0), size=(300, 300, 55))
    write_scan(scan, folder / "thick.nii.gz")
    check_true(lumen(folder / "thick.nii.gz").mesh, patient)


def test_convention_ras_is_lps_with_x_and_y_turned_round(folder: Path, straight: CtKidney, tmp_path: Path) -> None:
    ras = lumen(folder / "straight.nii.gz", "ras").mesh
    np.testing.assert_allclose(apply(T_RAS_LPS, ras.vertices), straight.mesh.vertices, atol=1e-6)
    assert ras.volume > 0, "the normals still point outward"
    for mesh, frame in ((ras, "ras"), (straight.mesh, "lps")):
        write_stl(tmp_path / f"{frame}.stl", mesh, frame)
        assert f"SPACE={frame.upper()}" in (tmp_path / f"{frame}.stl").read_bytes()[:80].decode()
        again = load_mesh_kidney(tmp_path / f"{frame}.stl").mesh
        np.testing.assert_allclose(again.bounds, mesh.bounds, atol=1e-3)


def test_fewer_faces_keep_the_surface(folder: Path, straight: CtKidney) -> None:
    light = scan_lumen(folder / "straight.nii.gz", SegmentationSettings(faces=15_000)).mesh
    assert len(light.faces) <= 15_000 < len(straight.mesh.faces)
    assert between(light, straight.mesh).max() < 0.4
    assert light.volume == pytest.approx(straight.mesh.volume, rel=0.005)
