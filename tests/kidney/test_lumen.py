import csv
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import ShapeError
from ursnav_torch.geometry import look_along, transform_from_quaternion
from ursnav_torch.kidney import Kidney, LumenDistance, load_mesh_kidney, observed_calyx


@pytest.fixture(scope="module")
def lumen(phantom: Kidney) -> LumenDistance:
    return LumenDistance.from_kidney(phantom)


def test_the_way_to_a_tip_is_no_shorter_than_the_straight_line(phantom: Kidney, lumen: LumenDistance) -> None:
    points = phantom.centerline.points_mm
    straight = np.linalg.norm(points[:, None] - phantom.tips_mm, axis=-1)
    assert np.all(lumen.to_calyces(points) >= straight - 0.5)


def test_the_way_to_a_tip_is_no_longer_than_along_the_centerline(phantom: Kidney, lumen: LumenDistance) -> None:
    tree = phantom.centerline
    along = tree.from_root_mm()
    for c in range(len(phantom.calyces)):
        path = tree.path_to(c)
        way = lumen.to_calyces(tree.points_mm[path])[:, c]
        assert np.all(way <= along[path[-1]] - along[path] + 0.3)
        assert way[-1] == pytest.approx(0.0, abs=1e-9)


def test_distances_grow_with_the_kidney(phantom: Kidney, lumen: LumenDistance) -> None:
    large = LumenDistance.from_kidney(phantom.scaled(1.8))
    points = phantom.centerline.points_mm[::7]
    np.testing.assert_allclose(large.to_calyces(1.8 * points), 1.8 * lumen.to_calyces(points), rtol=0.02, atol=0.5)


def test_a_camera_before_a_calyx_observes_it(phantom: Kidney, lumen: LumenDistance) -> None:
    tree = phantom.centerline
    for c in range(len(phantom.calyces)):
        path = tree.path_to(c)
        node = path[-8]
        T = look_along(tree.points_mm[node], phantom.tips_mm[c] - tree.points_mm[node])[None]
        assert observed_calyx(T, phantom, lumen).tolist() == [c]


def test_the_calyx_is_the_one_at_the_smallest_angle_of_those_near(phantom: Kidney, lumen: LumenDistance) -> None:
    rng = np.random.default_rng(0)
    nodes = phantom.centerline.points_mm[phantom.centerline.radius_mm > 1.2]
    positions = nodes[rng.integers(0, len(nodes), 50)]
    T = look_along(positions, rng.normal(size=(50, 3)))
    for pose, answer in zip(T, observed_calyx(T, phantom, lumen), strict=True):
        near = np.flatnonzero(lumen.to_calyces(pose[:3, 3])[0] <= 14.0)
        towards = phantom.tips_mm[near] - pose[:3, 3]
        cosines = towards @ pose[:3, 2] / np.linalg.norm(towards, axis=1)
        assert answer == (near[cosines.argmax()] if len(near) else -1)


def test_what_is_observed_does_not_depend_on_the_kidneys_scale(phantom: Kidney, lumen: LumenDistance) -> None:
    """14 mm of anatomy are 25.2 mm in the thesis's phantom."""
    twice = phantom.scaled(1.8)
    paths = [phantom.centerline.points_mm[phantom.centerline.path_to(c)][:-4] for c in range(len(phantom.calyces))]
    T = np.concatenate([look_along(at, calyx.tip_mm - at) for at, calyx in zip(paths, phantom.calyces, strict=True)])
    large = T.copy()
    large[:, :3, 3] *= 1.8
    small, answers = observed_calyx(T, phantom, lumen), observed_calyx(large, twice, LumenDistance.from_kidney(twice))
    assert (small == -1).mean() > 0.1 and np.mean(small == answers) > 0.95


def test_none_is_observed_from_far_and_of_no_camera(phantom: Kidney, lumen: LumenDistance) -> None:
    ureter = look_along(np.array([[-15.0, 0.0, -10.0]]), np.array([[-1.0, 0.0, 0.0]]))
    assert observed_calyx(ureter, phantom, lumen).tolist() == [-1]
    assert observed_calyx(np.zeros((0, 4, 4)), phantom, lumen).shape == (0,)


def test_one_pose_without_its_batch_is_refused(phantom: Kidney, lumen: LumenDistance) -> None:
    with pytest.raises(ShapeError, match=r"must have shape \(N, 4, 4\), got \(4, 4\)"):
        observed_calyx(np.eye(4), phantom, lumen)


@pytest.mark.parametrize("kidney", ["F_R", "M_R"])
def test_labels_of_real_stills_are_given_by_the_rule(data: Path, kidney: str) -> None:
    real = load_mesh_kidney(data / kidney / "lumen.stl", data / kidney / "calyces.csv")
    lumen = LumenDistance.from_kidney(real)
    names = [c.name for c in real.calyces]
    rows = []
    for style in ("simulation", "phantom", "invivo"):
        with open(data / kidney / style / "truth.csv", newline="") as file:
            rows += list(csv.DictReader(file))
    position, rotation = (np.array([[float(r[k]) for k in keys] for r in rows]) for keys in _COLUMNS)
    answer = observed_calyx(transform_from_quaternion(position, rotation), real, lumen)
    assert np.mean([names[a] == r["calyx"] for a, r in zip(answer, rows, strict=True)]) >= 0.98


_COLUMNS = (("x_mm", "y_mm", "z_mm"), ("qx", "qy", "qz", "qw"))
