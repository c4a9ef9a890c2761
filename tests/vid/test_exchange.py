from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.files import write_csv
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import Vid, build_vid, export_thesis, pose_cells, read_poses, read_views


@pytest.fixture
def exported(vid: Vid, tmp_path: Path) -> Path:
    """The first 20 views, as the thesis kept its own."""
    few = replace(
        vid, T_kidney_camera=vid.T_kidney_camera[:20], calyx=vid.calyx[:20],
        features=type(vid.features)(*(getattr(vid.features, f)[:20] for f in type(vid.features).__dataclass_fields__)),
    )  # fmt: skip
    export_thesis(few, tmp_path / "thesis")
    return tmp_path / "thesis"


def rewrite(folder: Path, columns: list[str], rows: list[dict[str, str]]) -> None:
    write_csv(folder / "poses.csv", columns, rows)


def test_poses_are_unitys_meters_at_the_thesiss_scale(vid: Vid, exported: Path) -> None:
    """A camera that looks along the kidney's -z looks along Unity's +z; a meter there is 92.6 mm of anatomy."""
    rows = read_csv(exported / "poses.csv", ["image", "calyx", "x_unity", "mm_per_unit"], "poses")
    assert float(rows[0]["mm_per_unit"]) == pytest.approx(92.592593)
    x, y, z = vid.T_kidney_camera[7, :3, 3]
    unity = [float(rows[7][c]) for c in ("x_unity", "y_unity", "z_unity")]
    np.testing.assert_allclose(unity, [x * 0.0108, y * 0.0108, -z * 0.0108], atol=1e-6)
    qx, qy, qz, qw = (float(rows[7][c]) for c in ("qx", "qy", "qz", "qw"))
    forward = [2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx**2 + qy**2)]  # Unity: rotation * (0, 0, 1)
    np.testing.assert_allclose(forward, vid.T_kidney_camera[7, :3, 2] * [1, 1, -1], atol=1e-5)


def test_points_are_text(vid: Vid, exported: Path) -> None:
    points = np.loadtxt(exported / "points" / "000007.txt")
    np.testing.assert_allclose(points, vid.features.points[7][vid.features.mask[7]].numpy(), atol=1e-3)
    assert len(list((exported / "points").iterdir())) == 20


def test_what_was_exported_comes_back(vid: Vid, exported: Path, phantom: Kidney, lens: Camera, tmp_path: Path) -> None:
    back = build_vid(
        phantom, lens, DefaultSettings(), RaycastRenderer, read_views(exported), tmp_path / "vid", workers=1
    )
    np.testing.assert_allclose(back.T_kidney_camera, vid.T_kidney_camera[:20], atol=2e-4)
    np.testing.assert_array_equal(back.calyx, vid.calyx[:20])
    assert torch.equal(back.features.points, vid.features.points[:20])
    assert torch.equal(back.features.maps, vid.features.maps[:20])
    off = (back.features.points_kidney - vid.features.points_kidney[:20]).norm(dim=-1)
    assert off.nanmedian() < 1e-3
    for view in range(20):
        assert back.image_path(view).read_bytes() == vid.image_path(view).read_bytes()


def test_millimeters_and_no_calyx_column(
    vid: Vid, exported: Path, phantom: Kidney, phantom_lumen: LumenDistance
) -> None:
    """Labels are then given by the rule; pictures may lie beside the table, and in color."""
    cells = pose_cells(vid.T_kidney_camera[:2])
    rows = [{"image": "first.jpg"} | cells[0], {"image": "000001.png"} | cells[1]]
    cv2.imwrite(str(exported / "first.jpg"), np.zeros((96, 96, 3), np.uint8))
    write_csv(exported / "poses.csv", list(rows[0]), rows)
    views = read_views(exported)
    assert [p.relative_to(exported).as_posix() for p in views.pictures] == ["first.jpg", "images/000001.png"]
    plan = views.plan(phantom, phantom_lumen)
    np.testing.assert_allclose(plan.T_kidney_camera, vid.T_kidney_camera[:2], atol=2e-6)
    np.testing.assert_array_equal(plan.calyx, vid.calyx[:2])


def test_units_may_be_stated(exported: Path, vid: Vid) -> None:
    twice = read_views(exported, mm_per_unit=2 * 1000 / 10.8)
    np.testing.assert_allclose(twice.T_kidney_camera[:, :3, 3], 2 * vid.T_kidney_camera[:20, :3, 3], atol=2e-4)
    assert angle_between(twice.T_kidney_camera[:, :3, 2], vid.T_kidney_camera[:20, :3, 2]).max() < 1e-5
    with pytest.raises(InputError, match="must be positive"):
        read_views(exported, mm_per_unit=-1)


def test_views_in_another_frame_are_refused(exported: Path, phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    with pytest.raises(InputError, match=r"of the 20 views .* stand outside the lumen.*mm_per_unit"):
        read_views(exported, mm_per_unit=1000).plan(phantom, phantom_lumen)


def test_calyces_of_another_kidney_are_refused(exported: Path, phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    views = read_views(exported)
    with pytest.raises(InputError, match=r"names the calyces Q; the kidney's are A, B"):
        replace(views, calyx=("Q",) * 20).plan(phantom, phantom_lumen)


def test_refusals(exported: Path, tmp_path: Path, vid: Vid) -> None:
    rows = read_csv(exported / "poses.csv", ["image"], "poses")
    columns = list(rows[0])
    with pytest.raises(InputError, match=r"no poses file .*nowhere"):
        read_views(tmp_path / "nowhere")
    rewrite(exported, [c for c in columns if c != "x_unity"], rows)
    with pytest.raises(InputError, match=r"lacks x_mm"):
        read_views(exported)
    rewrite(exported, columns, [*rows[:3], rows[3] | {"y_unity": "left"}])
    with pytest.raises(InputError, match=r"line 5: y_unity is 'left'"):
        read_views(exported)
    rewrite(exported, columns, [rows[0], rows[1] | {"image": "gone.png"}])
    with pytest.raises(InputError, match=r"line 3: there is no picture 'gone\.png'"):
        read_views(exported)
    rewrite(exported, columns, [rows[0], rows[1] | {"image": 300 * "9"}])  # longer than any file's name may be
    with pytest.raises(InputError, match=r"line 3: there is no picture '999"):
        read_views(exported)
    with pytest.raises(InputError, match="exists already"):
        export_thesis(vid, exported)


def test_pictures_of_another_lens_are_refused(exported: Path, phantom: Kidney, tmp_path: Path) -> None:
    lens = equidistant_camera(160, 120, 120)
    with pytest.raises(InputError, match="96 x 96 px, but the lens is 120 x 120"):
        build_vid(phantom, lens, DefaultSettings(), RaycastRenderer, read_views(exported), tmp_path / "vid", workers=1)
    assert not (tmp_path / "vid").exists()


def test_views_are_drawn_at_given_places(vid: Vid, phantom: Kidney, lens: Camera, tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    write_csv(table, POSE_COLUMNS, pose_cells(vid.T_kidney_camera[:6]))
    drawn = build_vid(phantom, lens, DefaultSettings(), RaycastRenderer, read_poses(table), tmp_path / "vid", workers=1)
    np.testing.assert_allclose(drawn.T_kidney_camera, vid.T_kidney_camera[:6], atol=1e-5)
    np.testing.assert_array_equal(drawn.calyx, vid.calyx[:6])
    here, there = (cv2.imread(str(v.image_path(2)), 0).astype(int) for v in (drawn, vid))
    assert np.abs(here - there).mean() < 0.5
