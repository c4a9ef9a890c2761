"""What a built VID holds: pictures, poses and wall points that belong together."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import EdgePoints, read_image
from ursnav_torch.geometry import apply, check_rigid, inverse, look_along
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RaycastRenderer, View
from ursnav_torch.tables import Row
from ursnav_torch.vid import PlanSettings, Vid, build, build_vid, load_vid, plan_views
from ursnav_torch.vid.draw import wall_points
from ursnav_torch.vid.store import poses_from_rows

VIEWS = (0, 20, 41, 77)


def test_convention_a_wall_point_is_seen_where_it_projects_at_its_depth(vid: Vid, renderer: RaycastRenderer) -> None:
    """``p_camera = inverse(T_kidney_camera) @ p_kidney``; its distance is the depth of its pixel, unless hidden."""
    T = vid.T_kidney_camera[5]
    depth = renderer.render(T).depth_mm
    walls = vid.kidney.mesh.triangles_center
    p_camera = apply(inverse(T), walls)
    pixels, inside = vid.camera.project(p_camera)
    x, y = np.rint(pixels[inside]).astype(int).T
    distance = np.linalg.norm(p_camera[inside], axis=1)
    seen = depth[y, x]
    assert np.mean(seen <= distance + 0.5) > 0.97, "nothing is seen through a wall"
    assert np.mean(np.abs(seen - distance) < 0.5) > 0.15, "and some of it is that wall"


def test_pictures_are_drawn_from_their_poses(vid: Vid, renderer: RaycastRenderer) -> None:
    for view in VIEWS:
        np.testing.assert_array_equal(
            read_image(vid.image_path(view)), renderer.render(vid.T_kidney_camera[view]).image
        )


def test_wall_points_lie_on_the_wall_and_under_their_edge_points(vid: Vid) -> None:
    off_px, off_mm = [], []
    for view in VIEWS:
        mask = vid.features.mask[view]
        wall = vid.features.points_kidney[view][mask].numpy()
        known = np.isfinite(wall).all(1)
        pixels, _ = vid.camera.project(apply(inverse(vid.T_kidney_camera[view]), wall[known]))
        off_px.append(np.linalg.norm(pixels - vid.features.points[view][mask].numpy()[known], axis=1))
        off_mm.append(np.abs(vid.kidney.mesh.nearest.on_surface(wall[known])[1]))
        assert known.mean() > 0.95
    assert (np.concatenate(off_px) < 0.01).all()
    assert np.mean(np.concatenate(off_mm) < 0.35) > 0.8, "an edge point takes the nearest depth within a pixel"


def test_features_are_padded_behind_their_points(vid: Vid) -> None:
    f = vid.features
    assert len(f) == len(vid) == len(vid.calyx) and f.points.shape[1] == vid.settings.points
    assert (f.mask.int().diff(dim=1) <= 0).all() and f.mask.any(1).float().mean() > 0.9
    assert (f.points[~f.mask] == 0).all() and torch.isnan(f.points_kidney[~f.mask]).all()
    assert (f.maps.float().flatten(2).norm(dim=2)[:, 0] - 1).abs().median() < 1e-2


def test_loading_gives_what_was_built(
    vid: Vid, plan: PlanSettings, phantom: Kidney, phantom_lumen: LumenDistance
) -> None:
    again = load_vid(vid.folder)
    views = plan_views(phantom, phantom_lumen, plan)
    check_rigid(again.T_kidney_camera, "T_kidney_camera")
    np.testing.assert_allclose(again.T_kidney_camera, views.T_kidney_camera, atol=5e-6)
    np.testing.assert_array_equal(again.calyx, views.calyx)
    assert again.camera == vid.camera and again.settings == vid.settings and again.calibration is None
    assert [c.name for c in again.kidney.calyces] == [c.name for c in phantom.calyces]
    np.testing.assert_allclose(again.kidney.tips_mm, phantom.tips_mm, atol=1e-3)
    np.testing.assert_allclose(again.kidney.centerline.points_mm, phantom.centerline.points_mm, atol=1e-3)
    assert again.calyx_name(-1) == "" and again.kidney.mesh.is_watertight


def test_a_finished_shard_is_never_drawn_again(
    vid: Vid, plan: PlanSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after its first shard, a build goes on with the second; progress counts from there; same bytes."""
    monkeypatch.setattr(build, "SHARD", 5)
    drawn: list[int] = []

    def stop_after_one(n: int) -> None:
        drawn.append(n)
        raise KeyboardInterrupt

    few = replace(plan, views_per_calyx=2, passage_views=2, around=0.0)
    given = (vid.kidney, vid.camera, vid.settings, RaycastRenderer, few)
    with pytest.raises(KeyboardInterrupt):
        build_vid(*given, tmp_path / "vid", workers=1, progress=lambda total, what: nullcontext(stop_after_one))
    assert not (tmp_path / "vid").exists() and drawn == [5]
    first = (tmp_path / "vid.partial" / "images" / "000000.png").stat().st_mtime_ns
    build_vid(*given, tmp_path / "vid", workers=1, progress=lambda total, what: nullcontext(drawn.append))
    assert drawn == [5, 5, 5, 4]
    assert (tmp_path / "vid" / "images" / "000000.png").stat().st_mtime_ns == first
    whole = build_vid(*given, tmp_path / "whole", workers=1)
    for path in sorted(p for p in whole.folder.rglob("*") if p.is_file()):
        assert path.read_bytes() == (tmp_path / "vid" / path.relative_to(whole.folder)).read_bytes()


def test_work_on_another_vid_is_not_taken_for_this_one(vid: Vid, plan: PlanSettings, tmp_path: Path) -> None:
    work = tmp_path / "vid.partial"
    (work / "shards").mkdir(parents=True)
    (work / "shards" / "00000.safetensors").write_bytes(b"of another build")
    (work / "fingerprint.json").write_text("{}")
    few = replace(plan, views_per_calyx=1, passage_views=0)
    built = build_vid(vid.kidney, vid.camera, vid.settings, RaycastRenderer, few, tmp_path / "vid", workers=1)
    assert len(built) == len(vid.kidney.calyces) == len(built.features)


def test_poses_name_the_line_that_is_wrong() -> None:
    cells = dict.fromkeys(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz"), "0") | {"qw": "1"}

    def row(line: int, **changed: str) -> Row:
        return Row(cells | changed, Path("v.csv"), line)

    np.testing.assert_array_equal(poses_from_rows([row(2)]), np.eye(4)[None])
    with pytest.raises(InputError, match=r"v\.csv, line 3: qy"):
        poses_from_rows([row(2), row(3, qy="")])
    with pytest.raises(InputError, match="quaternion is zero"):
        poses_from_rows([row(2, qw="0")])


def test_an_occluding_edge_lies_on_the_nearer_wall() -> None:
    """An edge between a near wall and a far one is the near one's, though its pixel may already show the far one."""
    lens = equidistant_camera(160.0, 96, 96)
    depth = np.full((96, 96), 20.0, np.float32)
    depth[:, :48] = 5.0
    view = View(np.zeros((96, 96), np.uint8), depth, np.zeros((96, 96, 3), np.float32))
    points = torch.tensor([[48.0, 40.0], [47.0, 40.0], [49.0, 40.0], [60.0, 60.0]])
    edges = EdgePoints(points, torch.zeros(4), torch.ones(4))
    T = look_along(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0]))
    wall = wall_points(edges, view, lens, T)
    np.testing.assert_allclose(np.linalg.norm(wall - T[:3, 3], axis=1), [5.0, 5.0, 20.0, 20.0], rtol=1e-5)
    rays = lens.rays(points.numpy().astype(float))[0]
    np.testing.assert_allclose(wall[0], T[:3, 3] + 5.0 * T[:3, :3] @ rays[0], atol=1e-4)
    nothing = View(view.image, np.full((96, 96), np.inf, np.float32), view.normals)
    assert np.isnan(wall_points(edges, nothing, lens, T)).all()
