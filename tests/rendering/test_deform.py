"""Warped kidneys stay closed and keep their size's promise; the camera goes with the wall around it."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import apply, rotation_angle, transform_from
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.deform import Deformation, WarpSettings, deform_mesh, local_radius
from ursnav_torch.scaling import scaled


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_nothing_changes_where_nothing_is_asked(lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    still = deform_mesh(lumen, WarpSettings(amplitude_mm=0), rng())
    np.testing.assert_allclose(still.mesh.vertices, lumen.vertices)
    for T in poses:
        np.testing.assert_allclose(still.carry(T), T, atol=1e-9)


def test_breathing_carries_the_camera_along(lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    moved = deform_mesh(lumen, WarpSettings(amplitude_mm=0, shift_mm=11), rng())
    shift = moved.carry(poses[0])[:3, 3] - poses[0][:3, 3]
    assert np.linalg.norm(shift) == pytest.approx(11)
    np.testing.assert_allclose(
        moved.mesh.vertices - lumen.vertices, np.tile(shift, (len(lumen.vertices), 1)), atol=1e-9
    )
    for T in poses:
        np.testing.assert_allclose(moved.carry(T)[:3, :3], T[:3, :3], atol=1e-9)


def test_a_rigid_motion_is_carried_exactly(lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    T_moved_rest = transform_from(Rotation.from_rotvec([0.2, -0.4, 0.3]).as_matrix(), [3.0, -2.0, 8.0])
    rest = np.asarray(lumen.vertices)
    deformation = Deformation(rest, trimesh.Trimesh(apply(T_moved_rest, rest), lumen.faces, process=False))
    for T in poses:
        np.testing.assert_allclose(deformation.carry(T), T_moved_rest @ T, atol=1e-9)


@pytest.mark.parametrize("amplitude_mm", [0.5, 2.5])
def test_smooth_warp_has_its_amplitude_and_stays_a_lumen(lumen: trimesh.Trimesh, amplitude_mm: float) -> None:
    for seed in range(5):
        warped = deform_mesh(lumen, WarpSettings(amplitude_mm), rng(seed)).mesh
        away = np.linalg.norm(warped.vertices - lumen.vertices, axis=1)
        assert np.sqrt(np.mean(away**2)) == pytest.approx(amplitude_mm)
        assert warped.is_watertight
        assert 0.5 < warped.volume / lumen.volume < 2
        assert np.sum(warped.face_normals * lumen.face_normals, axis=1).min() > 0.3


def test_distension_widens_a_tube_by_its_share() -> None:
    tube = trimesh.creation.capsule(height=40, radius=3, count=[48, 48])
    tube = tube.subdivide_to_size(1.0)
    middle = np.abs(tube.vertices[:, 2] - tube.vertices[:, 2].mean()) < 8
    assert np.median(local_radius(tube)[middle]) == pytest.approx(3, rel=0.03)
    wide = deform_mesh(tube, WarpSettings(amplitude_mm=0, distension=0.1), rng()).mesh
    assert np.median(np.hypot(*wide.vertices[middle, :2].T)) == pytest.approx(3.3, rel=0.01)


def test_the_carried_camera_sees_the_same_wall(lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    """The picture from the carried pose is nearer to the rest picture than that from the old pose."""
    camera = equidistant_camera(160, 64, 64)
    rest = RaycastRenderer(lumen, camera)
    carried, left = [], []
    for seed in range(4):
        deformation = deform_mesh(lumen, WarpSettings(2.0, shift_mm=2.0), rng(seed))
        warped = RaycastRenderer(deformation.mesh, camera)
        for T in poses:
            depth = rest.render(T).depth_mm
            carried.append(np.nanmedian(np.abs(warped.render(deformation.carry(T)).depth_mm - depth)))
            left.append(np.nanmedian(np.abs(warped.render(T).depth_mm - depth)))
            assert rotation_angle(deformation.carry(T), T) < 0.5
    assert np.mean(carried) < 0.5 * np.mean(left)


def test_same_seed_same_warp(lumen: trimesh.Trimesh) -> None:
    a, b, c = (deform_mesh(lumen, WarpSettings(), rng(seed)).mesh.vertices for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.5


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InputError, match="folds a wall"):
        WarpSettings(amplitude_mm=5, wavelength_mm=20)
    with pytest.raises(InputError, match="distension in"):
        WarpSettings(distension=0.9)


def test_a_larger_kidney_changes_alike(lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    twice, warp = lumen.copy(), WarpSettings(amplitude_mm=1.5, distension=0.1, shift_mm=3.0)
    twice.apply_scale(2.0)
    one, other = deform_mesh(lumen, warp, rng()), deform_mesh(twice, scaled(warp, 2.0), rng(), 2.0)
    np.testing.assert_allclose(other.mesh.vertices, 2 * np.asarray(one.mesh.vertices), atol=1e-2)
    for T in poses:
        away = T.copy()
        away[:3, 3] *= 2
        np.testing.assert_allclose(other.carry(away)[:3, 3], 2 * one.carry(T)[:3, 3], atol=1e-2)
