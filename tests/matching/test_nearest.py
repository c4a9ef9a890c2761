import pytest
import torch

from ursnav_torch.errors import InputError
from ursnav_torch.matching import Nearest
from ursnav_torch.matching.methods.nearest import trimmed_mean

COST = torch.rand(7, 3, 5, generator=torch.Generator().manual_seed(0))
MASK = torch.tensor([[1, 1, 1, 1, 1], [1, 1, 0, 0, 0], [1, 1, 1, 1, 0]]).bool()
MASKED = torch.where(MASK, COST, 1000.0)
SHARES = MASK / MASK.sum(1, keepdim=True)
EVEN = torch.full((7,), 1 / 7)


def test_means_over_each_side() -> None:
    for v in range(3):
        real = COST[:, v, MASK[v]]
        there, back = real.amin(1).mean(), real.amin(0).mean()
        for sides, expected in (("query_to_view", there), ("view_to_query", back), ("sum", there + back)):
            found = Nearest(sides, keep=1.0).reduce(MASKED.clone(), SHARES, EVEN)[v]
            torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("sides", ["query_to_view", "view_to_query", "sum"])
@pytest.mark.parametrize(("keep", "kept"), [(1.0, 7), (0.6, 4)])
def test_an_assignment_names_the_cheapest_counterparts_beside_the_distance(sides: str, keep: float, kept: int) -> None:
    method = Nearest(sides, keep)  # type: ignore[arg-type]
    found = method.assign(MASKED, SHARES, EVEN)
    torch.testing.assert_close(found.distance, method.reduce(MASKED.clone(), SHARES, EVEN))
    cheapest = MASKED.min(2)
    assert torch.equal(found.view_point, cheapest.indices.T)
    ranks = cheapest.values.argsort(0).argsort(0).T
    assert torch.equal(found.strength, (ranks < kept).float())


def test_weights_count_rows() -> None:
    weights = torch.tensor([0.5, 0.5, 0, 0, 0, 0, 0])
    found = Nearest(keep=1.0).reduce(MASKED.clone(), SHARES, weights)
    torch.testing.assert_close(found, MASKED[:2].amin(2).mean(0))


def test_trimmed_keeps_the_best_share() -> None:
    best = torch.tensor([[4.0], [1.0], [3.0], [2.0]])
    assert trimmed_mean(best, torch.full((4,), 0.25), 0.5).item() == pytest.approx(1.5)
    assert trimmed_mean(best, torch.full((4,), 0.25), 0.6).item() == pytest.approx((1 + 2 + 3 * 0.4) / 2.4)
    uneven = torch.tensor([0.1, 0.6, 0.1, 0.2])
    assert trimmed_mean(best, uneven, 0.7).item() == pytest.approx((0.6 * 1 + 0.1 * 2) / 0.7)
    torch.testing.assert_close(trimmed_mean(best, uneven, 1.0), trimmed_mean(best, uneven, 0.999999), atol=1e-4, rtol=0)


def test_even_weights_trim_as_uneven_ones_do() -> None:
    best = torch.rand(50, 20, generator=torch.Generator().manual_seed(1))
    even = torch.full((50,), 1 / 50)
    nearly = even + torch.linspace(-1e-6, 1e-6, 50)
    for keep in (0.3, 0.5, 0.7, 0.71):
        torch.testing.assert_close(trimmed_mean(best, even, keep), trimmed_mean(best, nearly, keep), atol=1e-4, rtol=0)


def test_pairs_are_the_cheapest_counterparts() -> None:
    found = Nearest(keep=0.6).pairs(COST[:, 0], EVEN)
    assert len(found.query) == 4
    torch.testing.assert_close(found.cost, COST[:, 0].amin(1).sort().values[:4])
    torch.testing.assert_close(COST[found.query, 0, found.view], found.cost)


def test_refuses_settings() -> None:
    with pytest.raises(InputError, match="'query_to_view', 'view_to_query' and 'sum'"):
        Nearest(sides="max")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="at most 1"):
        Nearest(keep=0)
