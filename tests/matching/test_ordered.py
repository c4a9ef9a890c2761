import numpy as np
import pytest
import torch

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching.ordered import Ordered, align_outlines

GENERATOR = torch.Generator().manual_seed(0)


def by_hand(cost: np.ndarray, skip: float) -> float:
    """Least cost over every rotation of the second outline, one cell after the other."""
    n, m = cost.shape
    best = np.inf
    for shift in range(m):
        table = np.full((n + 1, m + 1), np.inf)
        for i in range(n + 1):
            for j in range(m + 1):
                pair = table[i - 1, j - 1] + cost[i - 1, (j - 1 + shift) % m] if i and j else np.inf
                up = table[i - 1, j] + skip if i else np.inf
                left = table[i, j - 1] + skip if j else np.inf
                table[i, j] = min(pair, up, left) if i or j else 0
        best = min(best, table[n, m])
    return best / n


@pytest.mark.parametrize(("n", "m"), [(5, 5), (4, 7), (6, 3), (1, 1)])
def test_agrees_with_every_rotation_tried_by_hand(n: int, m: int) -> None:
    cost = torch.rand(n, m, 8, generator=GENERATOR)
    found = align_outlines(cost, Ordered(skip=0.3, starts=m))
    expected = [by_hand(cost[:, :, b].numpy(), 0.3) for b in range(8)]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-5)


def test_finds_the_rotation_of_an_outline_against_itself() -> None:
    index = torch.arange(40)
    for shift in (0, 13, 39):
        cost = (index[:, None] + shift - index) % 40 != 0
        assert align_outlines(cost.float()[:, :, None], Ordered(starts=1)).item() == 0


def test_the_order_counts() -> None:
    index = torch.arange(30)
    mirrored = ((index[:, None] + index) % 30 != 0).float()[:, :, None]
    assert align_outlines(mirrored, Ordered()).item() > 0.4
    assert mirrored.amin(1).max() == 0  # though every point has its counterpart


def test_refuses_what_it_cannot_use() -> None:
    with pytest.raises(InputError, match="skip > 0"):
        Ordered(skip=0)
    with pytest.raises(ShapeError, match=r"\(N, M, B\)"):
        align_outlines(torch.zeros(3, 3), Ordered())
