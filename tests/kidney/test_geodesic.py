import numpy as np
import pytest
import trimesh

from ursnav_torch.kidney.geodesic import ways_to
from ursnav_torch.kidney.grid import LumenGrid


@pytest.fixture(scope="module")
def grid(elbow: trimesh.Trimesh) -> LumenGrid:
    return LumenGrid.from_mesh(elbow, 0.4)


def test_a_way_in_sight_is_the_straight_line(grid: LumenGrid) -> None:
    source = grid.nearest([[2.0, 18.0, 2.0]])
    length = ways_to(grid, source).length_mm
    points = np.random.default_rng(0).uniform([0.5, 5, 0.5], [3.5, 19, 3.5], (200, 3))
    voxels = grid.nearest(points)
    straight = np.linalg.norm(grid.centers_mm[voxels] - grid.centers_mm[source], axis=1)
    np.testing.assert_allclose(length[voxels], straight, atol=1e-9)


def test_a_way_around_a_corner_touches_it(grid: LumenGrid) -> None:
    source = grid.nearest([[2.0, 18.0, 2.0]])
    ways = ways_to(grid, source)
    voxel = grid.nearest([[18.0, 2.0, 2.0]])
    a, b = grid.centers_mm[source[0]], grid.centers_mm[voxel[0]]
    over_the_edge = np.linalg.norm(a[:2] - 4) + np.linalg.norm(b[:2] - 4)  # both at the same height
    assert ways.length_mm[voxel[0]] == pytest.approx(over_the_edge, abs=0.4)
    assert ways.length_mm[voxel[0]] >= over_the_edge - 1e-9
    assert np.linalg.norm(grid.centers_mm[ways.corner[voxel[0]], :2] - 4) < 1.1


def test_the_nearest_source_counts_with_its_head_start(grid: LumenGrid) -> None:
    sources = grid.nearest([[2.0, 18.0, 2.0], [2.0, 6.0, 2.0]])
    both = ways_to(grid, sources, np.array([-3.0, 5.0])).length_mm
    one, other = (ways_to(grid, sources[[i]]).length_mm for i in range(2))
    best = np.minimum(one - 3, other + 5)
    assert np.all(both >= best - 0.4)
    assert np.mean(both <= best + 0.4) > 0.99  # but for places as far from the one as from the other


def test_there_is_no_way_beyond_the_limit(grid: LumenGrid) -> None:
    source = grid.nearest([[2.0, 18.0, 2.0]])
    free, limited = (ways_to(grid, source, limit_mm=limit).length_mm for limit in (np.inf, 5.0))
    assert np.all(limited[free > 5.0] == np.inf)
    near = free < 4.4  # 5 mm over voxels
    np.testing.assert_allclose(limited[near], free[near])
