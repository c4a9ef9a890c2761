"""Registration from the path alone, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.shared.em import OFFSET_MM, Drive, drive_through
from ursnav_torch.em_log import read_em_samples
from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import apply, inverse
from ursnav_torch.kidney import Kidney, load_mesh_kidney, make_phantom_kidney
from ursnav_torch.registration import Registration, branch_directions, register_centerline
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import poses_from_rows


@pytest.fixture(scope="module")
def found(phantom: Kidney, drive: Drive) -> Registration:
    return register_centerline(
        drive.position_em, drive.axis_em, phantom.mesh, phantom.centerline, sensor_offset_mm=OFFSET_MM
    )


def test_a_whole_drive_is_laid_into_the_kidney(phantom: Kidney, drive: Drive, found: Registration) -> None:
    assert drive.error_mm(drive.position_em, found.apply(drive.position_em)) < 3.0
    kidney_em = apply(inverse(drive.T_kidney_em), phantom.centerline.points_mm)
    assert drive.error_mm(kidney_em, found.apply(kidney_em)) < 3.0


def test_the_result_says_how_far_it_can_be_trusted(phantom: Kidney, drive: Drive, found: Registration) -> None:
    kidney_em = apply(inverse(drive.T_kidney_em), phantom.centerline.points_mm)
    expected = np.sqrt(np.mean(found.tre_mm(phantom.centerline.points_mm) ** 2))
    assert 0.4 < drive.error_mm(kidney_em, found.apply(kidney_em)) / expected < 2.0
    assert found.method == "centerline" and found.tre_loo_rmse_mm is None
    assert found.report is not None and found.report["gap"] > 12 and found.report["outside"] < 0.05


def test_it_is_written_and_read(found: Registration, tmp_path: Path) -> None:
    found.to_json(tmp_path / "r.json")
    again = Registration.from_json(tmp_path / "r.json")
    assert again.report == found.report and again.method == "centerline"
    np.testing.assert_array_equal(again.covariance, found.covariance)


@pytest.mark.slow
def test_mirrored_data_are_refused(phantom: Kidney, drive: Drive) -> None:
    position, axis = drive.position_em * [1, 1, -1], drive.axis_em * [1, 1, -1]
    with pytest.raises(RegistrationError, match="Mirrored, the path's samples would fit this kidney better"):
        register_centerline(position, axis, phantom.mesh, phantom.centerline, sensor_offset_mm=OFFSET_MM)


@pytest.mark.slow
@pytest.mark.parametrize(("calyces", "other"), [(range(0, 3), 10), (range(3, 7), 12)])
def test_half_a_path_does_not_fit_another_kidney(calyces: range, other: int) -> None:
    own, wrong = make_phantom_kidney(11), make_phantom_kidney(other)
    half = drive_through(own, calyces, 1)
    with pytest.raises(RegistrationError, match="another kidney's"):
        register_centerline(half.position_em, half.axis_em, wrong.mesh, wrong.centerline, sensor_offset_mm=OFFSET_MM)


def test_a_straight_path_is_refused(phantom: Kidney) -> None:
    rng = np.random.default_rng(0)
    line = np.linspace(0, 30, 60)[:, None] * [1.0, 0, 0] + rng.normal(0, 0.3, (60, 3))
    with pytest.raises(RegistrationError, match="leave the registration open: another pose"):
        register_centerline(line, np.tile([1.0, 0, 0], (60, 1)), phantom.mesh, phantom.centerline)


def test_a_short_path_is_refused(phantom: Kidney, drive: Drive) -> None:
    with pytest.raises(RegistrationError, match=r"too short: its 12 visible samples make \d+ steps"):
        register_centerline(drive.position_em[:12], drive.axis_em[:12], phantom.mesh, phantom.centerline)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_meters_are_refused(phantom: Kidney, drive: Drive, factor: float) -> None:
    with pytest.raises(InputError, match="Check the units"):
        register_centerline(drive.position_em * factor, drive.axis_em, phantom.mesh, phantom.centerline)


def test_a_path_without_axes_is_refused(phantom: Kidney, drive: Drive) -> None:
    with pytest.raises(InputError, match="dx, dy, dz"):
        register_centerline(drive.position_em, np.full_like(drive.axis_em, np.nan), phantom.mesh, phantom.centerline)
    with pytest.raises(ShapeError, match="positions and axes"):
        register_centerline(drive.position_em, drive.axis_em[:-1], phantom.mesh, phantom.centerline)


def test_convention_branches_lead_away_from_the_pelvis(phantom: Kidney) -> None:
    tree, direction = phantom.centerline, branch_directions(phantom.centerline)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1)
    for calyx in range(len(phantom.calyces)):
        path = tree.path_to(calyx)
        assert np.mean(np.sum(direction[path] * tree.tangents(path), axis=1) > 0.5) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["F_R", "M_R"])
def test_real_kidneys_from_the_path_alone(data: Path, name: str) -> None:
    kidney = load_mesh_kidney(data / name / "lumen.stl", calyces=data / name / "calyces.csv")
    samples = read_em_samples(data / name / "video_em.csv")
    truth = data / name / "video_truth.csv"
    T = poses_from_rows(read_csv(truth, ("image",), "truth"))
    sensor = apply(T, np.broadcast_to(OFFSET_MM, (len(T), 3)))
    found = register_centerline(
        samples.position_mm, samples.axis, kidney.mesh, kidney.centerline, sensor_offset_mm=OFFSET_MM
    )
    assert np.sqrt(np.mean(np.sum((found.apply(samples.position_mm) - sensor) ** 2, axis=1))) <= 3.0
