from pathlib import Path

import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney, load_mesh_kidney, write_calyces
from ursnav_torch.kidney.checks import check_lumen
from ursnav_torch.kidney.mesh import enlargement, read_mesh


@pytest.fixture(scope="module")
def files(phantom: Kidney, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """lumen.* of the phantom in all formats, and its calyces.csv with a row `pelvis`."""
    folder = tmp_path_factory.mktemp("kidney, with ümlaut=1 [a]")
    for name in ("lumen.stl", "lumen.ply", "lumen.obj", "lumen.glb"):
        phantom.mesh.export(folder / name)
    (folder / "ASCII.STL").write_text(trimesh.exchange.stl.export_stl_ascii(phantom.mesh))
    write_calyces(folder / "calyces.csv", phantom.calyces, phantom.pelvis_mm)
    return folder


@pytest.mark.parametrize("name", ["lumen.stl", "lumen.ply", "lumen.obj", "lumen.glb", "ASCII.STL"])
def test_every_format_gives_the_same_lumen(files: Path, phantom: Kidney, name: str) -> None:
    mesh = read_mesh(files / name)
    mesh.merge_vertices()
    assert len(mesh.vertices) == len(phantom.mesh.vertices)
    assert mesh.volume == pytest.approx(phantom.mesh.volume, rel=1e-4)
    np.testing.assert_allclose(mesh.bounds, phantom.mesh.bounds, atol=1e-3)


def test_given_calyces_keep_names_places_and_poles(files: Path, phantom: Kidney) -> None:
    kidney = load_mesh_kidney(files / "lumen.stl", files / "calyces.csv")
    assert [(c.name, c.pole) for c in kidney.calyces] == [(c.name, c.pole) for c in phantom.calyces]
    np.testing.assert_allclose(kidney.tips_mm, phantom.tips_mm, atol=1e-3)
    assert kidney.mesh.is_watertight and kidney.scale == 1.0
    assert np.linalg.norm(kidney.pelvis_mm - phantom.pelvis_mm) < 2


def test_calyces_are_found_named_and_told_their_pole(files: Path, phantom: Kidney) -> None:
    kidney = load_mesh_kidney(files / "lumen.stl", superior=[0, 0, 1])
    assert [c.name for c in kidney.calyces][:3] == ["A", "B", "C"]
    assert {c.pole for c in kidney.calyces} >= {"upper", "lower"}
    assert len(phantom.calyces) <= len(kidney.calyces) <= len(phantom.calyces) + 2


def test_scale_enlarges_mesh_and_given_calyces(files: Path, phantom: Kidney) -> None:
    kidney = load_mesh_kidney(files / "lumen.stl", files / "calyces.csv", scale=1.8)
    np.testing.assert_allclose(kidney.tips_mm, 1.8 * phantom.tips_mm, atol=2e-3)
    assert kidney.mesh.volume == pytest.approx(1.8**3 * phantom.mesh.volume, rel=1e-3)
    assert kidney.scale == 1.8


def test_meters_become_mm_by_a_scale_that_is_no_enlargement(phantom: Kidney, files: Path, tmp_path: Path) -> None:
    phantom.scaled(0.001).mesh.export(tmp_path / "m.ply")
    with pytest.raises(InputError, match=r"seems to be in meters: set kidney.scale=1000"):
        load_mesh_kidney(tmp_path / "m.ply")
    kidney = load_mesh_kidney(tmp_path / "m.ply", scale=1000)
    assert kidney.scale == 1.0
    assert kidney.mesh.volume == pytest.approx(phantom.mesh.volume, rel=1e-3)


@pytest.mark.parametrize(("scale", "larger"), [(1, 1), (1.8, 1.8), (10, 1), (1000, 1), (1800, 1.8), (1 / 1.8, 1)])
def test_enlargement_is_what_a_unit_does_not_explain(scale: float, larger: float) -> None:
    assert enlargement(scale) == pytest.approx(larger)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), 70.0])
def test_other_scales_are_refused(scale: float) -> None:
    with pytest.raises(InputError, match=r"kidney\.scale is"):
        enlargement(scale)


def test_unreadable_files_are_refused(files: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no mesh file"):
        read_mesh(tmp_path / "none.stl")
    with pytest.raises(InputError, match="There is no mesh file"):
        read_mesh(tmp_path)
    (tmp_path / "empty.stl").touch()
    with pytest.raises(InputError, match="is empty"):
        read_mesh(tmp_path / "empty.stl")
    (tmp_path / "kidney.step").write_text("x")
    with pytest.raises(InputError, match=r"accepted: .stl, .ply, .obj, .glb"):
        read_mesh(tmp_path / "kidney.step")
    for name in ("lumen.stl", "lumen.ply", "lumen.glb"):
        half = (files / name).read_bytes()[:5000]
        (tmp_path / name).write_bytes(half)
        with pytest.raises(InputError, match=r"cannot be read as|has no usable|is not closed|ends before its data do"):
            load_mesh_kidney(tmp_path / name)


@pytest.mark.parametrize("tail", [b"\0" * 100, b"COLOR=" * 9, b"\n", b"endsolid nothing\n" * 20])
@pytest.mark.parametrize("head", [b"made by somebody", b"solid lumen"])
def test_bytes_after_a_binary_stl_are_passed_over(files: Path, tmp_path: Path, tail: bytes, head: bytes) -> None:
    data = (files / "lumen.stl").read_bytes()
    path = tmp_path / "tail.stl"
    path.write_bytes(head.ljust(80) + data[80:] + tail)
    np.testing.assert_array_equal(read_mesh(path).triangles, read_mesh(files / "lumen.stl").triangles)


def test_a_truncated_stl_says_how_many_triangles_it_lacks(files: Path, tmp_path: Path) -> None:
    data = (files / "lumen.stl").read_bytes()
    (tmp_path / "half.stl").write_bytes(data[: 84 + 50 * 10 + 7])
    with pytest.raises(InputError, match=r"ends before its data do: its header counts \d+ triangles, and it holds 10"):
        read_mesh(tmp_path / "half.stl")


def test_an_ascii_stl_that_is_cut_short_or_has_decimal_commas_is_told(tmp_path: Path) -> None:
    text = trimesh.creation.box((30, 30, 30)).export(file_type="stl_ascii")
    path = tmp_path / "m.stl"
    for wrong, reason in ((text[:-200], "cut short: the word endsolid"), (text.replace(".", ","), "decimal commas")):
        path.write_text(wrong, encoding="utf-8")
        with pytest.raises(InputError, match=reason):
            read_mesh(path)
    path.write_text(text, encoding="utf-8")
    assert len(read_mesh(path).faces) == 12


def test_the_given_stl_with_bytes_after_it(cases: Path) -> None:
    assert len(read_mesh(cases / "19-stl-bytes-after" / "lumen.stl").faces) == 28808


def test_slicers_markups_are_named_as_what_they_are(files: Path, tmp_path: Path) -> None:
    (tmp_path / "calyces.mrk.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds markups of 3D Slicer, which kidney=ct takes"):
        load_mesh_kidney(files / "lumen.stl", tmp_path / "calyces.mrk.json")


def test_points_in_another_frame_are_refused(files: Path, phantom: Kidney, tmp_path: Path) -> None:
    write_calyces(tmp_path / "c.csv", phantom.scaled(3.0).calyces)
    with pytest.raises(InputError, match=r"A at \[.*\] lies .* mm outside the lumen of lumen.stl"):
        load_mesh_kidney(files / "lumen.stl", tmp_path / "c.csv")


@pytest.mark.parametrize("corner", [162, 4_294_967_295, 65_402])
def test_triangles_that_name_corners_which_are_not_there_are_refused(tmp_path: Path, corner: int) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    body = "element face 1\nproperty list uchar uint vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
    (tmp_path / "a.ply").write_text(f"{head}{body}3 0 1 {corner}\n")
    with pytest.raises(InputError, match=r"names corner|cannot be read as PLY|holds no triangles"):
        read_mesh(tmp_path / "a.ply")


def test_given_damaged_meshes_end_in_sentences(cases: Path) -> None:
    for path in sorted((cases / "fuzz").glob("mesh_*")):
        try:
            check_lumen(read_mesh(path), path.name, 1.0)
        except InputError:
            continue


def test_a_binary_stl_may_call_itself_solid(files: Path, tmp_path: Path) -> None:
    data = (files / "lumen.stl").read_bytes()
    (tmp_path / "a.stl").write_bytes(b"solid of facet".ljust(80) + data[80:])
    assert len(read_mesh(tmp_path / "a.stl").faces) == len(read_mesh(files / "lumen.stl").faces)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.stl", "<html>404</html>", "is a page of the web, and no STL"),
        ("a.ply", "version https://git-lfs.github.com/spec/v1\noid", "is a pointer of Git LFS"),
        ("a.stl", "v 0.0 1.0 2.0\n" * 20, "is text without the word solid, and no STL"),
        ("a.obj", "solid\0\0", "is no text, and no OBJ"),
        ("a.obj", "v 1,5 2,5 3,5\nv 1,5 2,5 3,5\n", "has decimal commas"),
        ("a.ply", "ply\nend_header\n1,5 2,5 3,5\n", "has decimal commas"),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nelement face 1\nend_header\n0 0 0\n1 0 0\n0 1",
            "ends before its data do: its header counts 4 lines, and it holds 3",
        ),
    ],
)
def test_files_of_another_kind_than_their_name_says_are_told(tmp_path: Path, name: str, text: str, reason: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=rf"{name} {reason}"):
        read_mesh(tmp_path / name)


def test_a_corner_that_is_no_place_is_named() -> None:
    mesh = trimesh.creation.box((40, 30, 20))
    vertices = mesh.vertices.copy()
    vertices[2] = np.nan
    with pytest.raises(InputError, match=r"x has 1 corners that are no place, corner 3 at \[nan, nan, nan\]"):
        check_lumen(trimesh.Trimesh(vertices, mesh.faces, process=False), "x", 1.0)
