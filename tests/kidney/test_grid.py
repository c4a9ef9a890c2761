import numpy as np
import pytest
import trimesh

from ursnav_torch.kidney import Kidney
from ursnav_torch.kidney.grid import LumenGrid, distance_to_surface


@pytest.fixture(scope="module")
def tube() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=3.0, height=30.0, sections=128)


def test_clearance_is_the_distance_to_the_wall_and_negative_outside(tube: trimesh.Trimesh) -> None:
    grid = LumenGrid.from_mesh(tube, 0.5)
    x = np.linspace(-3.8, 3.8, 60)
    points = np.column_stack([x, np.zeros(60), np.linspace(-8, 8, 60)])
    np.testing.assert_allclose(grid.clearance_mm(points), 3.0 - np.abs(x), atol=0.3)  # a kink on the axis
    away_from_axis = np.abs(x) > 0.5
    np.testing.assert_allclose(grid.clearance_mm(points)[away_from_axis], (3.0 - np.abs(x))[away_from_axis], atol=0.07)


def test_inside_agrees_with_trimesh(phantom: Kidney) -> None:
    grid = LumenGrid.from_mesh(phantom.mesh, 0.8)
    nodes = np.argwhere(np.ones(grid.index.shape, bool))[::97]
    expected = phantom.mesh.contains(grid.origin_mm + grid.voxel_mm * nodes)
    assert np.mean((grid.index[tuple(nodes.T)] >= 0) == expected) > 0.999


def test_volume_is_the_mesh_volume(elbow: trimesh.Trimesh) -> None:
    grid = LumenGrid.from_mesh(elbow, 0.25)
    assert len(grid.centers_mm) * 0.25**3 == pytest.approx(elbow.volume, rel=0.08)


def test_distance_to_surface_agrees_with_trimesh(elbow: trimesh.Trimesh) -> None:
    points = np.random.default_rng(0).uniform(-3, 23, (300, 3))
    expected = trimesh.proximity.closest_point(elbow, points)[1]
    np.testing.assert_allclose(distance_to_surface(elbow, points, edge_mm=0.5), expected, atol=0.01)


def test_nearest_is_the_voxel_around_a_point_or_the_nearest_inside(tube: trimesh.Trimesh) -> None:
    grid = LumenGrid.from_mesh(tube, 0.5)
    points = np.random.default_rng(1).uniform(-6, 6, (200, 3))
    best = np.linalg.norm(points[:, None] - grid.centers_mm, axis=2).min(axis=1)
    found = np.linalg.norm(points - grid.centers_mm[grid.nearest(points)], axis=1)
    np.testing.assert_allclose(found, best)


def test_graph_joins_each_voxel_with_its_26_neighbors(tube: trimesh.Trimesh) -> None:
    grid = LumenGrid.from_mesh(tube, 0.5)
    graph = grid.graph
    middle = int(grid.nearest([[0.0, 0.0, 0.0]])[0])
    row = graph[[middle]].tocoo()
    assert len(row.data) == 26
    assert sorted(set(np.round(row.data / 0.5, 6))) == pytest.approx([1.0, 2**0.5, 3**0.5])
    assert abs(graph - graph.T).max() == 0
