import numpy as np
import pytest
import torch

from ursnav_torch.errors import InputError
from ursnav_torch.matching import ConvergenceWarning, Sinkhorn

COST = torch.rand(9, 4, 12, generator=torch.Generator().manual_seed(0))
MASK = torch.ones(4, 12, dtype=torch.bool)
MASK[1, 5:] = False
COST[:, 1, 5:] = 1000.0
WEIGHTS = torch.linspace(1, 2, 9) / torch.linspace(1, 2, 9).sum()


@pytest.mark.parametrize("domain", ["plain", "log"])
@pytest.mark.parametrize("double", [False, True])
def test_marginals_are_right(domain: str, double: bool) -> None:
    settings = Sinkhorn(iterations=2000, tolerance=1e-4, domain=domain, double=double)  # type: ignore[arg-type]
    found = settings.transport(COST, MASK.float(), WEIGHTS)
    torch.testing.assert_close(found.plan.sum(2), WEIGHTS[:, None].expand(9, 4).to(found.plan), atol=2e-4, rtol=0)
    even = MASK / MASK.sum(1, keepdim=True)
    torch.testing.assert_close(found.plan.sum(0), even.to(found.plan), atol=1e-5, rtol=0)
    assert found.plan[:, 1, 5:].sum() == 0
    assert (found.marginal_error <= 1e-4).all()


@pytest.mark.parametrize("epsilon", [0.03, 0.1])
def test_agrees_with_pot(epsilon: float) -> None:
    ot = pytest.importorskip("ot", reason="POT is not installed")
    settings = Sinkhorn(epsilon=epsilon, iterations=20000, tolerance=1e-9, double=True)
    found = settings.transport(COST, MASK.float(), WEIGHTS)
    for v in range(4):
        n = int(MASK[v].sum())
        cost = COST[:, v, :n].double().numpy()
        source = WEIGHTS.double().numpy()
        plan = ot.sinkhorn(source / source.sum(), np.full(n, 1 / n), cost, epsilon, numItermax=20000, stopThr=1e-12)
        np.testing.assert_allclose(found.plan[:, v, :n].numpy(), plan, atol=1e-7)
        assert found.cost[v].item() == pytest.approx((plan * cost).sum(), abs=1e-7)


@pytest.mark.parametrize("domain", ["plain", "log"])
def test_weights_count_in_distances_as_they_do_in_the_plan(domain: str) -> None:
    """A point of no weight costs nothing; weights' sum does not matter."""
    settings = Sinkhorn(iterations=2000, tolerance=1e-5, domain=domain)  # type: ignore[arg-type]
    cost = COST.clone()
    cost[4] = torch.where(MASK, 0.9, 1000.0)  # a query's point that is like none
    even, without = torch.full((9,), 1 / 9), torch.ones(9)
    without[4] = 0.0
    shares = MASK / MASK.sum(1, keepdim=True)
    rest = [i for i in range(9) if i != 4]
    left_out = settings.reduce(cost[rest], shares, torch.full((8,), 1 / 8))
    torch.testing.assert_close(settings.reduce(cost, shares, without), left_out, atol=1e-3, rtol=0)
    torch.testing.assert_close(settings.assign(cost, shares, without).distance, left_out, atol=1e-3, rtol=0)
    assert (settings.reduce(cost, shares, even) > left_out + 0.03).all()


def test_both_domains_agree_and_log_stands_a_tiny_epsilon() -> None:
    plain = Sinkhorn(iterations=500, tolerance=1e-3).transport(COST, MASK.float(), WEIGHTS)
    log = Sinkhorn(iterations=500, tolerance=1e-3, domain="log").transport(COST, MASK.float(), WEIGHTS)
    torch.testing.assert_close(plain.plan, log.plan, atol=1e-5, rtol=0)
    tiny = Sinkhorn(epsilon=1e-4, iterations=50, tolerance=float("inf"), domain="log").transport(
        COST, MASK.float(), WEIGHTS
    )
    assert tiny.plan.isfinite().all()


def test_too_few_iterations_are_told() -> None:
    with pytest.warns(ConvergenceWarning, match="raise iterations or epsilon"):
        Sinkhorn(iterations=1, tolerance=1e-6).transport(COST, MASK.float(), WEIGHTS)


def test_a_plain_kernel_that_underflows_is_told() -> None:
    with pytest.warns(ConvergenceWarning, match="domain='log'"):
        Sinkhorn(epsilon=1e-4).transport(COST, MASK.float(), WEIGHTS)


def test_refuses_settings() -> None:
    with pytest.raises(InputError, match="epsilon > 0"):
        Sinkhorn(epsilon=0)
    with pytest.raises(InputError, match="'plain' and 'log'"):
        Sinkhorn(domain="dual")  # type: ignore[arg-type]


@pytest.mark.parametrize("domain", ["plain", "log"])
def test_dummies_take_what_has_no_counterpart(domain: str) -> None:
    """Three points of the query lie on three of the view's, one is clutter and one edge is missing."""
    cost = torch.full((4, 1, 4), 0.9)
    cost[[0, 1, 2], 0, [2, 0, 1]] = 0.02
    settings = Sinkhorn(epsilon=0.02, dummy_cost=0.2, domain=domain)  # type: ignore[arg-type]
    even = torch.full((4,), 0.25)
    found = settings.assign(cost, even[None], even)
    assert found.view_point[0, :3].tolist() == [2, 0, 1]
    assert (found.strength[0, :3] > 0.9).all() and float(found.strength[0, 3]) < 0.01
    assert float(found.distance) == pytest.approx(0.75 * 0.02 + 2 * 0.25 * 0.2, abs=0.01)
    forced = Sinkhorn(epsilon=0.02, domain=domain).assign(cost, even[None], even)  # type: ignore[arg-type]
    assert float(forced.distance) == pytest.approx(0.75 * 0.02 + 0.25 * 0.9, abs=0.01)


def test_dummies_leave_absent_points_absent() -> None:
    found = Sinkhorn(dummy_cost=0.3).transport(COST, MASK.float(), WEIGHTS)
    assert found.plan.shape == COST.shape and found.plan[:, 1, 5:].sum() == 0 and found.cost.isfinite().all()
    with pytest.raises(InputError, match="dummy_cost must be > 0"):
        Sinkhorn(dummy_cost=0.0)
