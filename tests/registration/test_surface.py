"""Registration from touched points, the distance field and the search under it."""

import contextlib
import warnings

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.shared.em import Drive
from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import apply, inverse, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration import register_surface
from ursnav_torch.registration.field import DistanceField
from ursnav_torch.registration.search import Misfit, Poses, as_tensor, even_rotations


def touched(kidney: Kidney, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points, _ = trimesh.sample.sample_surface(kidney.mesh, count, seed=seed)
    T_kidney_em = transform_from(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 100, 3))
    return apply(inverse(T_kidney_em), points) + rng.normal(0, 0.4, (count, 3)), T_kidney_em


@pytest.mark.slow
def test_touched_points_find_their_place(phantom: Kidney) -> None:
    em, T_kidney_em = touched(phantom, 60)
    em[:4] += np.random.default_rng(1).normal(0, 10, (4, 3))
    found = register_surface(em, phantom.mesh)
    kidney_em = apply(inverse(T_kidney_em), phantom.mesh.vertices)
    error = np.sqrt(np.mean(np.sum((found.apply(kidney_em) - phantom.mesh.vertices) ** 2, axis=1)))
    assert error < 1.0 and found.fre_rmse_mm < 0.6
    assert not found.used[:4].any() and found.n == found.used.sum() and found.method == "surface"


def test_few_points_of_one_spot_are_refused(phantom: Kidney) -> None:
    em, _ = touched(phantom, 400)
    near = em[np.argsort(np.linalg.norm(em - em[0], axis=1))[:20]]
    with pytest.raises(RegistrationError, match=r"leave the registration open|determine the registration only"):
        register_surface(near, phantom.mesh)
    with pytest.raises(RegistrationError, match="5 touched points are too few"):
        register_surface(em[:5], phantom.mesh)


@pytest.mark.slow
def test_a_path_through_the_lumen_is_no_set_of_touches(phantom: Kidney, drive: Drive) -> None:
    with pytest.raises(RegistrationError, match=r"runs along the wall.*registration=centerline"):
        register_surface(drive.position_em, phantom.mesh, axis_em=drive.axis_em)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with contextlib.suppress(RegistrationError):
            register_surface(drive.position_em, phantom.mesh)
    assert any("steps of" in str(w.message) and "registration=centerline" in str(w.message) for w in said)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_axes_at_the_wall_are_touches_whichever_way_they_are_counted(phantom: Kidney, sign: float) -> None:
    em, T_kidney_em = touched(phantom, 60)
    _, _, face = trimesh.proximity.closest_point(phantom.mesh, apply(T_kidney_em, em))
    tilt = np.random.default_rng(2).normal(0, 0.4, (60, 3))
    axis = sign * (phantom.mesh.face_normals[face] + tilt) @ T_kidney_em[:3, :3]
    axis[:5] = np.nan
    assert register_surface(em, phantom.mesh, axis_em=axis).suspicions == ()
    with pytest.raises(ShapeError, match="as many axes as points"):
        register_surface(em, phantom.mesh, axis_em=axis[1:])


def test_inputs_are_checked(phantom: Kidney) -> None:
    em, _ = touched(phantom, 20)
    with pytest.raises(InputError, match="Check the units"):
        register_surface(em / 1000, phantom.mesh)
    with pytest.raises(InputError, match=r"trim=0\.1"):
        register_surface(em, phantom.mesh, trim=0.1)
    with pytest.raises(ShapeError, match=r"points \(N, 3\)"):
        register_surface(em[:, :2], phantom.mesh)


def test_the_field_is_the_signed_distance_near_the_wall_and_grows_beyond() -> None:
    tube = trimesh.creation.capsule(height=30.0, radius=5.0, count=(64, 64))
    field = DistanceField.from_mesh(tube)
    rng = np.random.default_rng(0)
    on_axis, away = rng.uniform(-12, 12, 400)[:, None] * [0, 0, 1.0], rng.normal(size=(400, 3)) * [1, 1, 0]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    radius = rng.uniform(1.5, 5.8, 400)
    points = as_tensor(on_axis + away * radius[:, None])
    distance, gradient = field.sample(points)
    np.testing.assert_allclose(distance, radius - 5, atol=0.3)
    assert np.sum(gradient.numpy() * away, axis=1).min() > 0.9
    np.testing.assert_allclose(field.rough(points), distance, atol=0.45)
    assert field.sample(as_tensor([[25.0, 0, 0]]))[0].item() == pytest.approx(20, abs=0.3)


def test_even_rotations_leave_no_gap() -> None:
    R = even_rotations(4608)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    others = Rotation.random(200, rng=np.random.default_rng(0)).as_matrix()
    cosine = (np.einsum("aij,bij->ab", others, R).max(axis=1) - 1) / 2
    assert np.degrees(np.arccos(cosine)).max() < 15


@pytest.mark.parametrize("term", ["distances", "directions"])
def test_the_gradient_is_the_derivative_of_the_cost(term: str) -> None:
    rng = np.random.default_rng(0)
    poses = Poses(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64), torch.zeros(3))
    points, normal = torch.from_numpy(rng.normal(size=(2, 1, 6, 3)))
    normal = normal / normal.norm(dim=-1, keepdim=True)

    def misfit(at: Poses) -> Misfit:
        found = Misfit.zero(torch.ones(1, 6, dtype=torch.float64))
        if term == "distances":
            moved = at.apply(points[0])
            found.add_distances(moved - at.t, ((moved - 0.3) * normal).sum(-1), normal, 0.5, 0.8)
        else:
            axis = points / points.norm(dim=-1, keepdim=True)
            found.add_directions(axis @ at.R.mT, normal, 0.7, 1.0)
        return found

    gradient = misfit(poses).gradient[0]
    for k in range(6):
        step = torch.zeros(1, 6, dtype=torch.float64)
        step[0, k] = 1e-6
        slope = (misfit(poses.moved(step)).cost.sum() - misfit(poses.moved(-step)).cost.sum()) / 2e-6
        assert gradient[k].item() == pytest.approx(slope.item(), abs=1e-5)
