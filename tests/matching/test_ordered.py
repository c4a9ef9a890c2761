import numpy as np
import pytest
import torch

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching.ordered import Ordered, align_outlines

GENERATOR = torch.Generator().manual_seed(0)


def by_hand(cost: np.ndarray, skip: float, reach: int) -> float:
    """Least cost over every rotation of the second outline, one cell after the other."""
    n = len(cost)
    best = np.inf
    for shift in range(n):
        table = np.full((n + 1, n + 1), np.inf)
        for i in range(n + 1):
            for j in range(max(0, i - reach), min(n, i + reach) + 1):
                pair = table[i - 1, j - 1] + cost[i - 1, (j - 1 + shift) % n] if i and j else np.inf
                up = table[i - 1, j] + skip if i else np.inf
                left = table[i, j - 1] + skip if j else np.inf
                table[i, j] = min(pair, up, left) if i or j else 0
        best = min(best, table[n, n])
    return best / n


@pytest.mark.parametrize(("n", "within"), [(5, 1.0), (7, 0.3), (12, 0.16), (12, 0.01), (2, 1.0), (1, 1.0)])
def test_agrees_with_every_rotation_tried_by_hand(n: int, within: float) -> None:
    cost = torch.rand(8, n, n, generator=GENERATOR)
    found = align_outlines(cost[None], Ordered(skip=0.3, starts=n, within=within))
    expected = [by_hand(c, 0.3, max(1, round(within * n))) for c in cost.numpy()]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-5)


def test_finds_the_rotation_of_an_outline_against_itself() -> None:
    index = torch.arange(40)
    for shift in (0, 13, 39):
        cost = (index[:, None] + shift - index) % 40 != 0
        assert align_outlines(cost.float()[None, None], Ordered(starts=1)).item() == 0


def test_a_few_points_may_be_left_out_on_either_side() -> None:
    index = torch.arange(40)
    counterpart = torch.where(index < 20, index, index + 3) % 40  # three of the second outline have none
    cost = (counterpart[:, None] != index).float()
    assert align_outlines(cost[None, None], Ordered(skip=0.3, starts=1)).item() == pytest.approx(6 * 0.3 / 40)


def test_the_best_way_round_counts_alone() -> None:
    ways = torch.rand(2, 6, 9, 9, generator=GENERATOR)
    ways[1, :3] += 1
    ways[0, 3:] += 1
    each = [align_outlines(way[None], Ordered(starts=9, within=1)) for way in ways]
    torch.testing.assert_close(align_outlines(ways, Ordered(starts=18, within=1)), torch.minimum(*each))
    torch.testing.assert_close(
        align_outlines(ways, Ordered(starts=3, within=1))[:3], align_outlines(ways[:1, :3], Ordered(within=1))
    )


def test_the_order_counts() -> None:
    index = torch.arange(30)
    mirrored = ((index[:, None] + index) % 30 != 0).float()[None, None]
    assert align_outlines(mirrored, Ordered()).item() > 0.4
    assert mirrored.amin(2).max() == 0  # though every point has its counterpart


def test_no_pairs_and_what_it_refuses() -> None:
    assert align_outlines(torch.zeros(2, 0, 9, 9), Ordered()).shape == (0,)
    for wrong in ({"skip": 0}, {"starts": 0}, {"within": 1.5}):
        with pytest.raises(InputError, match="skip > 0, starts >= 1 and 0 < within <= 1"):
            Ordered(**wrong)
    for shape in ((1, 3, 3), (1, 1, 3, 4), (1, 1, 0, 0), (0, 1, 3, 3)):
        with pytest.raises(ShapeError, match=r"\(W, B, N, N\)"):
            align_outlines(torch.zeros(shape), Ordered())
