from pathlib import Path

import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.kidney.checks import check_lumen, check_radius
from ursnav_torch.kidney.mesh import read_mesh


@pytest.fixture
def mesh(phantom: Kidney) -> trimesh.Trimesh:
    return phantom.mesh.copy()


def test_a_lumen_passes_as_it_is(mesh: trimesh.Trimesh) -> None:
    checked = check_lumen(mesh.copy(), "a.stl", 1.0)
    assert len(checked.faces) == len(mesh.faces) and checked.volume == pytest.approx(mesh.volume)


def test_the_unmerged_triangles_of_an_stl_are_merged(mesh: trimesh.Trimesh) -> None:
    soup = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)
    assert check_lumen(soup, "a.stl", 1.0).is_watertight


def test_an_inside_out_mesh_is_turned_with_a_warning(mesh: trimesh.Trimesh) -> None:
    mesh.invert()
    with pytest.warns(UserWarning, match=r"a\.stl was inside-out"):
        assert check_lumen(mesh, "a.stl", 1.0).volume > 0


def test_triangles_that_face_the_other_way_are_turned_with_a_warning(mesh: trimesh.Trimesh) -> None:
    faces = mesh.faces.copy()
    faces[::50] = faces[::50, ::-1]
    with pytest.warns(UserWarning, match="some triangles faced the other way"):
        turned = check_lumen(trimesh.Trimesh(mesh.vertices, faces, process=False), "a.stl", 1.0)
    assert turned.is_winding_consistent and turned.volume == pytest.approx(mesh.volume)


def test_an_open_mesh_is_refused_with_its_holes_counted(mesh: trimesh.Trimesh) -> None:
    keep = np.ones(len(mesh.faces), bool)
    keep[[10, len(keep) // 2]] = False
    mesh.update_faces(keep)
    with pytest.raises(InputError, match=r"a\.stl is not closed: 6 boundary edges around 2 holes"):
        check_lumen(mesh, "a.stl", 1.0)


@pytest.mark.parametrize(("radii", "share"), [((1.0,), 0.01), ((2.0, 1.5, 1.0), 0.03), ((1.0,) * 8, 0.03)])
def test_crumbs_of_up_to_3_percent_are_dropped_and_listed(
    mesh: trimesh.Trimesh, radii: tuple[float, ...], share: float
) -> None:
    crumbs = [trimesh.creation.icosphere(subdivisions=2, radius=r) for r in radii]
    for n, crumb in enumerate(crumbs):
        crumb.apply_translation([30, 5 * n, 0])
    assert sum(c.volume for c in crumbs) < share * mesh.volume
    with pytest.warns(UserWarning, match=rf"{len(radii)} crumbs .* were dropped: .* mm3 at \[30\.0, .*\]"):
        checked = check_lumen(trimesh.util.concatenate([mesh, *crumbs]), "a.stl", 1.0)
    assert checked.volume == pytest.approx(mesh.volume)


@pytest.mark.parametrize("seam", [1e-5, 3e-4, 9e-4])
def test_corners_that_a_writer_rounded_anew_are_welded(mesh: trimesh.Trimesh, seam: float) -> None:
    loose = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)
    loose.vertices = loose.vertices + np.random.default_rng(0).uniform(-seam / 4, seam / 4, loose.vertices.shape)
    checked = check_lumen(loose, "a.stl", 1.0)
    assert checked.is_watertight and len(checked.vertices) == len(mesh.vertices)


def test_a_real_mesh_with_stray_pieces_passes(data: Path) -> None:
    with pytest.warns(UserWarning, match=r"3 crumbs .* 2\.20% of the volume"):
        assert check_lumen(read_mesh(data / "patients" / "b" / "lumen.stl"), "b", 1.0).is_watertight


def test_several_pieces_are_refused_with_their_sizes(mesh: trimesh.Trimesh) -> None:
    stone = trimesh.creation.icosphere(radius=6.0)
    stone.apply_translation([40, 0, 0])
    with pytest.raises(InputError, match=r"consists of 2 pieces \(\d\.\d\d mL, 0\.\d\d mL\).*; up to 3%"):
        check_lumen(trimesh.util.concatenate([mesh, stone]), "a.stl", 1.0)


def test_the_outer_organ_is_refused() -> None:
    organ = trimesh.creation.icosphere(subdivisions=4)
    organ.apply_scale([28.0, 22.0, 55.0])
    with pytest.raises(InputError, match=r"holds 14\d mL, which fits a whole kidney"):
        check_lumen(organ, "a.stl", 1.0)
    with pytest.raises(InputError, match="room for a ball of 22 mm radius"):
        check_radius(22.0, "a.stl", 1.0)
    check_radius(22.0, "a.stl", 1.8)


@pytest.mark.parametrize(
    ("factor", "match"), [(0.1, "centimeters: set kidney.scale=10"), (8.0, "from corner to corner")]
)
def test_an_implausible_size_is_refused(mesh: trimesh.Trimesh, factor: float, match: str) -> None:
    mesh.apply_scale(factor)
    with pytest.raises(InputError, match=match):
        check_lumen(mesh, "a.stl", 1.0)


def test_a_mesh_without_triangles_is_refused() -> None:
    with pytest.raises(InputError, match="has no usable triangles"):
        check_lumen(trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), int)), "a.ply", 1.0)
