import math

import numpy as np
import pytest
import torch
from matching_shapes import blob, tangents

from ursnav_torch.errors import InputError
from ursnav_torch.matching import PairCost, ShapeContext, pack
from ursnav_torch.matching.cost import ABSENT
from ursnav_torch.matching.point_sets import ViewPoints
from ursnav_torch.matching.prepared import PreparedViews

SETTINGS = ShapeContext(scale=60.0)
QUERY, VIEWS = blob(0, 30), [blob(1, 40), blob(2, 25)]


def costs(cost: PairCost, query: np.ndarray = QUERY, views: list[np.ndarray] = VIEWS) -> torch.Tensor:
    """Costs (Pq, V, P) as the matcher computes them."""
    packed = pack(views)
    along = torch.zeros(packed.mask.shape)
    for row, view in zip(along, views, strict=True):
        row[: len(view)] = torch.from_numpy(tangents(view))
    prepared = PreparedViews(ViewPoints(packed.points, packed.mask, along), SETTINGS, cost)
    asked = prepared.query(torch.from_numpy(query).float(), torch.from_numpy(tangents(query)).float(), None)
    return prepared.costs(asked, slice(0, len(views))).clone()


def histograms(points: np.ndarray) -> np.ndarray:
    from ursnav_torch.matching import describe

    packed = pack([points])
    return describe(packed.points, packed.mask, SETTINGS)[0].double().numpy()


@pytest.mark.parametrize("compare", ["hellinger", "chi2"])
def test_shape_term_agrees_with_its_formula(compare: str) -> None:
    a, b = histograms(QUERY)[:, None], histograms(VIEWS[0])[None]
    if compare == "hellinger":
        expected = 1 - np.sqrt(a * b).sum(2)
    else:
        expected = 0.5 * ((a - b) ** 2 / np.maximum(a + b, 1e-30)).sum(2)
    found = costs(PairCost(compare=compare))[:, 0]
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-6)


def test_chi2_lies_between_the_bounds_that_hellinger_gives() -> None:
    hellinger, chi2 = costs(PairCost())[:, 0], costs(PairCost(compare="chi2"))[:, 0]
    assert (chi2 >= hellinger - 1e-5).all()
    assert (chi2 <= 1 - (1 - hellinger) ** 2 + 1e-5).all()


def test_position_term_is_the_clamped_distance() -> None:
    found = costs(PairCost(shape_weight=0, position_weight=1, position_clamp_px=30))[:, 0]
    expected = np.minimum(np.linalg.norm(QUERY[:, None] - VIEWS[0][None], axis=2), 30) / 30
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-3)


def test_direction_term_takes_edges_modulo_pi() -> None:
    found = costs(PairCost(shape_weight=0, direction_weight=1))[:, 0]
    difference = tangents(QUERY)[:, None] - tangents(VIEWS[0])[None]
    np.testing.assert_allclose(found.numpy(), np.sin(difference + math.pi) ** 2, atol=1e-5)


@pytest.mark.parametrize("compare", ["hellinger", "chi2"])
def test_terms_are_averaged_by_their_weights(compare: str) -> None:
    together = costs(PairCost(compare=compare, shape_weight=2, position_weight=1, direction_weight=1))
    alone = [
        costs(PairCost(compare=compare)),
        costs(PairCost(shape_weight=0, position_weight=1)),
        costs(PairCost(shape_weight=0, direction_weight=1)),
    ]
    torch.testing.assert_close(together[:, 0], (2 * alone[0] + alone[1] + alone[2])[:, 0] / 4, atol=1e-4, rtol=0)


def test_places_without_a_point_cost_more_than_any_point() -> None:
    for cost in (PairCost(), PairCost(compare="chi2", position_weight=1, direction_weight=1)):
        found = costs(cost)
        assert found[:, 1, 25:].min() >= ABSENT - 1
        assert found[:, 0].max() <= 1 + 1e-5
        assert found.min() >= -1e-5


def test_refuses_settings() -> None:
    with pytest.raises(InputError, match="'hellinger' and 'chi2'"):
        PairCost(compare="l2")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not all 0"):
        PairCost(shape_weight=0)
    with pytest.raises(InputError, match="must be > 0"):
        PairCost(position_clamp_px=0)
