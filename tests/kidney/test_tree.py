import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.tree import grow_tree


def test_parents_come_before_children_and_all_paths_start_at_the_root(phantom: Kidney) -> None:
    tree = phantom.centerline
    assert tree.parent[0] == -1
    assert np.all(tree.parent[1:] >= 0) and np.all(tree.parent < np.arange(len(tree.parent)))
    for c, calyx in enumerate(phantom.calyces):
        path = tree.path_to(c)
        assert path[0] == 0
        np.testing.assert_array_equal(tree.parent[path[1:]], path[:-1])
        np.testing.assert_allclose(tree.points_mm[path[-1]], calyx.tip_mm)


def test_the_calyx_of_a_node_is_the_only_one_it_leads_to(phantom: Kidney) -> None:
    tree = phantom.centerline
    below: list[set[int]] = [set() for _ in tree.parent]
    for c in range(len(phantom.calyces)):
        for node in tree.path_to(c):
            below[node].add(c)
    assert [next(iter(b)) if len(b) == 1 else -1 for b in below] == tree.calyx.tolist()


def test_nodes_lie_in_the_lumen_and_know_their_distance_to_the_wall(phantom: Kidney) -> None:
    tree = phantom.centerline
    assert phantom.mesh.contains(tree.points_mm).all()
    distance = trimesh.proximity.closest_point(phantom.mesh, tree.points_mm)[1]
    assert np.all(tree.radius_mm < distance + 0.05) and np.all(tree.radius_mm > distance - 0.3)


def test_the_way_is_counted_from_the_root(phantom: Kidney) -> None:
    tree = phantom.centerline
    along = tree.from_root_mm()
    path = tree.path_to(0)
    steps = np.linalg.norm(np.diff(tree.points_mm[path], axis=0), axis=1)
    np.testing.assert_allclose(along[path], np.append(0.0, np.cumsum(steps)))
    assert steps.max() < 1.2


def test_in_a_straight_tube_the_centerline_is_its_axis() -> None:
    tube = trimesh.creation.cylinder(radius=3.0, height=40.0, sections=64)
    tree = grow_tree(LumenGrid.from_mesh(tube, 0.5), [0, 0, -15], [[0, 0, 17.0]])
    middle = tree.points_mm[2:-5]
    assert np.linalg.norm(middle[:, :2], axis=1).max() < 0.4
    tangents = tree.tangents(tree.path_to(0))
    assert np.degrees(np.arccos(tangents[:, 2].clip(-1, 1))).max() < 8
    assert tree.from_root_mm()[-1] == pytest.approx(tree.points_mm[-1, 2] - tree.points_mm[0, 2], rel=0.02)


def test_tangents_turn_gently_even_where_branches_meet(phantom: Kidney) -> None:
    tree = phantom.centerline
    for c in range(len(phantom.calyces)):
        path = tree.path_to(c)
        tangents = tree.tangents(path)
        np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0)
        turn = np.arccos(np.sum(tangents[1:] * tangents[:-1], axis=1).clip(-1, 1))
        assert np.degrees(turn).max() < 25
        way_on = np.diff(tree.points_mm[path], axis=0)
        assert np.mean(np.sum(way_on * tangents[1:], axis=1) > 0) > 0.95


def test_a_tip_on_the_way_to_another_still_has_its_own_node() -> None:
    tube = trimesh.creation.cylinder(radius=3.0, height=40.0, sections=64)
    tree = grow_tree(LumenGrid.from_mesh(tube, 0.5), [0, 0, -15], [[0, 0, 17.0], [0, 0, 5.0]])
    for c, z in ((0, 17.0), (1, 5.0)):
        np.testing.assert_allclose(tree.points_mm[tree.path_to(c)[-1]], [0, 0, z])


def test_a_closed_neck_and_an_unknown_calyx_are_refused(phantom: Kidney) -> None:
    boxes = [trimesh.creation.box((6, 6, 6), trimesh.transformations.translation_matrix([x, 0, 0])) for x in (0, 10)]
    grid = LumenGrid.from_mesh(trimesh.util.concatenate(boxes), 0.5)
    with pytest.raises(InputError, match="No way through the lumen leads from the pelvis to calyx number 1"):
        grow_tree(grid, [0, 0, 0], [[10, 0, 0]])
    with pytest.raises(InputError, match="The centerline has calyces 0 to"):
        phantom.centerline.path_to(99)
