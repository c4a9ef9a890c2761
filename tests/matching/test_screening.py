import math
from pathlib import Path

import numpy as np
import pytest
import torch
from matching_shapes import blob, rotated, tangents

from ursnav_torch.errors import InputError
from ursnav_torch.matching import Matching, Occupancy, PairCost, Screen, build_screen, estimate_directions, pack
from ursnav_torch.matching.occupancy import best_sums, cell_indices, fill, table_rows

GRID = Occupancy((0, 0), (250, 250))
VIEWS = [blob(seed, 40 + seed % 20) for seed in range(300)]


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Screen:
    packed = pack(VIEWS)
    path = tmp_path_factory.mktemp("screen") / "a b=ü" / "views.safetensors"
    return Screen(build_screen(path, packed.points, packed.mask, settings=GRID))


def test_a_points_bin_scores_two_its_neighbors_one() -> None:
    points, direction = torch.tensor([[[5.0, 125.0]]]), torch.tensor([[0.1]])
    table = fill(points, torch.ones(1, 1, dtype=torch.bool), direction, GRID)
    cube = table[:, 0].reshape(GRID.orientations, GRID.cells, GRID.cells)
    x, y, turn = (int(i) for i in cell_indices(points[0, 0], direction[0, 0], GRID))
    assert (x, y, turn) == (0, 12, 0)
    assert cube[0, 12, 0] == 2
    assert cube.sum() == 2 + 3 * 6 - 1  # three directions round the circle, two columns of three rows at the border
    assert cube[GRID.orientations - 1, 11, 1] == cube[1, 13, 0] == 1


def test_places_without_a_point_fill_nothing() -> None:
    assert fill(torch.zeros(2, 3, 2), torch.zeros(2, 3, dtype=torch.bool), torch.zeros(2, 3), GRID).sum() == 0


def test_sums_are_the_best_hypothesis() -> None:
    rng = np.random.default_rng(0)
    table = rng.integers(0, 3, (50, 30)).astype(np.uint8)
    rows = rng.integers(0, 50, (4, 9))
    expected = table[rows].sum(1).max(0)[5:25]
    np.testing.assert_array_equal(best_sums(table, rows, slice(5, 25)), expected)


def test_finds_a_turned_partial_cluttered_view(screen: Screen) -> None:
    rng = np.random.default_rng(1)
    for seed in range(0, 300, 30):
        seen = rotated(VIEWS[seed], math.radians(rng.uniform(-5, 5)))
        kept = seen[: round(0.7 * len(seen))]
        query = torch.from_numpy(np.vstack([kept, rng.uniform(60, 190, (15, 2))])).float()
        assert seed in screen.shortlist(query, count=10).tolist()
        views, distances = screen.nearest(
            query, settings=Matching(cost=PairCost(position_weight=1, direction_weight=0.5)), count=50
        )
        assert views[0] == seed
        assert (distances.diff() >= 0).all()


def test_hypotheses_hold_rolls_scales_and_shifts() -> None:
    settings = Occupancy((0, 0), (250, 250), rolls_deg=(0.0, 90.0), scales=(1.0,), shifts_px=(0.0, 20.0))
    rows = table_rows(torch.tensor([[125.0, 60.0]]), torch.tensor([0.0]), settings)
    assert len(rows) == 2 * 4 == len(settings.poses())
    moved = torch.tensor([[190.0, 125.0]])  # x towards y is clockwise on the screen: from the top to the right
    x, y, turn = (int(i) for i in cell_indices(moved[0], torch.tensor(math.pi / 2), settings))
    assert rows[4, 0] == (turn * settings.cells + y) * settings.cells + x


def test_estimated_directions_follow_the_curve() -> None:
    packed = pack(VIEWS[:5])
    found = estimate_directions(packed.points, packed.mask)
    for i in range(5):
        error = np.sin(found[i, packed.mask[i]].numpy() - tangents(VIEWS[i]))
        assert np.median(np.abs(error)) < 0.1
    assert found[~packed.mask].abs().sum() == 0
    assert estimate_directions(torch.zeros(1, 1, 2), torch.ones(1, 1, dtype=torch.bool)).item() == 0


def test_odd_queries(screen: Screen) -> None:
    assert len(screen.shortlist(torch.zeros(0, 2))) == 200
    assert len(screen.shortlist(torch.rand(1000, 2) * 250, count=7)) == 7
    assert len(screen.shortlist(torch.full((3, 2), 1e6), count=9999)) == len(screen) == 300


def test_refuses_files_that_are_no_screen(tmp_path: Path) -> None:
    packed = pack(VIEWS[:3])
    whole = build_screen(tmp_path / "s.safetensors", packed.points, packed.mask)
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(whole.read_bytes()[:-10])
    with pytest.raises(InputError, match="build it again"):
        Screen(cut)
    with pytest.raises(InputError, match="cannot be opened"):
        Screen(tmp_path / "none.safetensors")
    with pytest.raises(InputError, match="nothing to screen"):
        build_screen(tmp_path / "e.safetensors", packed.points, torch.zeros_like(packed.mask))
    with pytest.raises(InputError, match="cells >= 2"):
        Occupancy((0, 0), (1, 1), cells=1)
