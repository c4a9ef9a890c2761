import numpy as np
import pytest
import torch
from matching_shapes import blob
from scipy.optimize import linear_sum_assignment

from ursnav_torch.errors import InputError
from ursnav_torch.matching import Hungarian, Matcher, Matching, pack
from ursnav_torch.matching.methods.hungarian import assignment_bound

VIEWS = pack([blob(seed, 20 + seed % 3 * 10) for seed in range(30)])
QUERY = torch.from_numpy(blob(3, 30, phase=0.05)).float()


def by_scipy(matcher: Matcher) -> np.ndarray:
    """Mean assignment cost of every view, each solved in full."""
    out = []
    for view, mask in enumerate(matcher.mask):
        query = matcher.views.query(QUERY, None, None)
        cost = matcher.views.costs_of(query, torch.tensor([view]))[:, 0, mask].double().numpy()
        rows, columns = linear_sum_assignment(cost)
        out.append(cost[rows, columns].mean())
    return np.array(out)


def test_all_agree_with_scipy() -> None:
    matcher = Matcher(VIEWS.points, VIEWS.mask, settings=Matching(method=Hungarian(exact=None, double=True)))
    np.testing.assert_allclose(matcher.distances(QUERY).numpy(), by_scipy(matcher), atol=1e-6)


@pytest.mark.parametrize("exact", [1, 5])
def test_pruning_keeps_the_best(exact: int) -> None:
    matcher = Matcher(VIEWS.points, VIEWS.mask, settings=Matching(method=Hungarian(exact=exact)))
    found, full = matcher.distances(QUERY).numpy(), by_scipy(matcher)
    best = np.argsort(full)[:exact]
    assert np.argsort(found)[:exact].tolist() == best.tolist()
    np.testing.assert_allclose(found[best], full[best], atol=1e-6)
    assert (found <= full + 1e-6).all()
    assert (np.delete(found, best) >= full[best].max() - 1e-6).all()


def test_bound_is_below_the_solution_for_any_numbers_of_points() -> None:
    generator = torch.Generator().manual_seed(0)
    for rows, columns in ((5, 5), (3, 9), (9, 3), (1, 4)):
        cost = torch.rand(rows, 20, columns, generator=generator)
        bound = assignment_bound(cost, torch.ones(20, columns, dtype=torch.bool))
        for v in range(20):
            i, j = linear_sum_assignment(cost[:, v].numpy())
            assert bound[v] <= cost[i, v, j].mean() + 1e-6


def test_pairs_are_one_to_one() -> None:
    matcher = Matcher(VIEWS.points, VIEWS.mask, settings=Matching(method=Hungarian()))
    (found,) = matcher.match(QUERY, [3])
    assert len(set(found.query.tolist())) == len(set(found.view.tolist())) == len(found.view) == 20


def test_refuses_settings() -> None:
    with pytest.raises(InputError, match="at least 1"):
        Hungarian(exact=0)
