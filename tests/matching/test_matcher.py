import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matching_shapes import blob, rotated, tangents

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching import (
    Hungarian,
    Matcher,
    Matching,
    Nearest,
    PairCost,
    ShapeContext,
    Sinkhorn,
    pack,
    shape_distances,
)

METHODS = [Nearest(), Nearest(sides="sum", keep=1.0), Sinkhorn(), Hungarian(exact=None)]
EVERY_TERM = PairCost(position_weight=1, direction_weight=0.5)


def matcher(sets: list[np.ndarray], settings: Matching | None = None) -> Matcher:
    packed = pack(sets)
    along = torch.zeros(packed.mask.shape)
    for row, points in zip(along, sets, strict=True):
        row[: len(points)] = torch.from_numpy(tangents(points)) if len(points) else 0
    return Matcher(packed.points, packed.mask, along, settings, roll_center_px=(125, 125))


def asked(points: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(points).float(), torch.from_numpy(tangents(points)).float()


@pytest.mark.parametrize("method", METHODS)
def test_finds_the_shape_sampled_elsewhere(method: object) -> None:
    views = [blob(seed) for seed in range(20)]
    found = matcher(views, Matching(method=method, cost=EVERY_TERM))  # type: ignore[arg-type]
    for seed in (0, 7, 19):
        assert found.distances(*asked(blob(seed, phase=0.05))).argmin() == seed


@pytest.mark.parametrize("method", METHODS)
def test_permutation_of_points_changes_no_distance(method: object) -> None:
    rng = np.random.default_rng(0)
    views, query = [blob(seed, 40) for seed in range(6)], blob(9, 35)
    plain = shape_distances([query], views, _name(method), **_fields(method))
    mixed = shape_distances(
        [rng.permutation(query)], [rng.permutation(v) for v in views], _name(method), **_fields(method)
    )
    torch.testing.assert_close(plain, mixed, atol=2e-6, rtol=0)


@pytest.mark.parametrize("method", METHODS)
def test_ragged_sets_in_a_batch_are_as_each_alone(method: object) -> None:
    views, query = [blob(1, 10), blob(2, 60), blob(3, 33)], blob(4, 25)
    together = shape_distances([query], views, _name(method), scale=60.0, **_fields(method))[0]
    alone = [shape_distances([query], [v], _name(method), scale=60.0, **_fields(method))[0, 0] for v in views]
    torch.testing.assert_close(
        together, torch.stack(alone), atol=1e-3 if isinstance(method, Sinkhorn) else 2e-6, rtol=0
    )


@pytest.mark.parametrize("method", [*METHODS, Nearest(sides="view_to_query")])
def test_pairs_at_once_are_as_each_alone_however_many_points_views_have(method: object) -> None:
    views = [blob(1, 10), blob(2, 60), blob(3, 33), blob(5, 45)]
    found = matcher(views, Matching(method=method, cost=EVERY_TERM))  # type: ignore[arg-type]
    points, along = asked(blob(4, 25))
    chosen = torch.tensor([2, 0, 3])
    together = found.assign(points.expand(3, -1, -1), along.expand(3, -1), chosen)
    alone = found.distances(points, along)[chosen]
    torch.testing.assert_close(together.distance, alone, atol=1e-3 if isinstance(method, Sinkhorn) else 2e-6, rtol=0)
    for view, points_of_it in zip(chosen.tolist(), together.view_point, strict=True):
        assert points_of_it.max() < len(views[view])


def test_two_threads_agree_with_one() -> None:
    views = [blob(seed, 100) for seed in range(300)]
    found = matcher(views, Matching(cost=EVERY_TERM))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = found.distances(*asked(blob(5, 100)))
        torch.set_num_threads(2)
        two = found.distances(*asked(blob(5, 100)))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(one, two, atol=1e-6, rtol=0)


def test_inference_mode_may_come_and_go() -> None:
    found, query = matcher([blob(seed, 100) for seed in range(300)]), asked(blob(5, 100))
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.inference_mode():
                inside = found.distances(*query).clone()
            torch.testing.assert_close(found.distances(*query), inside)
    finally:
        torch.set_num_threads(before)


def test_roll_search_finds_a_turned_view() -> None:
    views = [blob(seed) for seed in range(30)]
    rolls = Matching(cost=EVERY_TERM, roll_deg=(-20.0, 0.0, 20.0))
    for seed in (3, 11):
        query = asked(rotated(blob(seed, phase=0.03), math.radians(-20)))
        plain, searched = matcher(views, Matching(cost=EVERY_TERM)), matcher(views, rolls)
        found = searched.distances(*query)
        assert found.argmin() == seed
        assert found[seed] < 0.5 * plain.distances(*query)[seed]
        assert searched.match(query[0], [seed], query[1])[0].cost.mean() < 0.1


def test_tangent_frame_finds_a_view_at_any_roll() -> None:
    views = [blob(seed) for seed in range(30)]
    found = matcher(views, Matching(descriptor=ShapeContext(frame="tangent")))
    for seed, turn in ((2, 100), (8, 180), (21, 275)):
        assert found.distances(*asked(rotated(blob(seed, phase=0.03), math.radians(turn)))).argmin() == seed


@pytest.mark.parametrize("method", METHODS)
def test_match_returns_the_permutation_it_was_given(method: object) -> None:
    view = blob(6, 50)
    order = np.random.default_rng(1).permutation(50)
    query = asked(view)[0][order], asked(view)[1][order]
    (found,) = matcher([blob(1, 70), view], Matching(method=method, cost=EVERY_TERM)).match(query[0], [1], query[1])  # type: ignore[arg-type]
    assert order[found.query.numpy()].tolist() == found.view.tolist()
    assert found.cost.max() < 1e-3


def test_match_numbers_rows_as_given_when_masks_have_holes() -> None:
    view = torch.from_numpy(blob(6, 50)).float()[None]
    mask = torch.rand(1, 50, generator=torch.Generator().manual_seed(0)) < 0.7
    engine = Matcher(view, mask, settings=Matching(method=Nearest(keep=1.0)))
    (found,) = engine.match(view[0], [0], mask=mask[0])
    assert found.query.tolist() == found.view.tolist()
    assert sorted(found.query.tolist()) == mask[0].nonzero().flatten().tolist()


def test_weight_zero_takes_clutter_out() -> None:
    view = blob(6, 50)
    clutter = np.random.default_rng(2).uniform(60, 190, (20, 2))
    query = torch.from_numpy(np.vstack([view, clutter])).float()
    weights = torch.cat([torch.ones(50), torch.zeros(20)])
    packed = pack([view])
    engine = Matcher(packed.points, packed.mask, settings=Matching(method=Nearest(keep=1.0)))
    assert engine.distances(query, weights=weights)[0] < 1e-5
    assert engine.distances(query)[0] > 0.05


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        arrays(np.float64, st.tuples(st.integers(0, 4), st.just(2)), elements=st.integers(0, 3)), min_size=1, max_size=4
    ),
    arrays(np.float64, st.tuples(st.integers(0, 4), st.just(2)), elements=st.integers(0, 3)),
)
def test_tiny_doubled_and_collinear_sets_never_throw(views: list[np.ndarray], query: np.ndarray) -> None:
    for name, extra in (
        ("nearest", {"compare": "chi2", "position_weight": 1.0}),
        ("hungarian", {}),
        ("sinkhorn", {"tolerance": math.inf}),
    ):
        found = shape_distances([query], views, name, **extra)
        empty = torch.tensor([not len(v) or not len(query) for v in views])
        assert found.shape == (1, len(views))
        assert found[0][empty].isinf().all()
        assert found[0][~empty].isfinite().all()


def test_empty_lists_give_empty_answers() -> None:
    assert shape_distances([], [blob(0)]).shape == (0, 1)
    assert shape_distances([blob(0)], []).shape == (1, 0)
    packed = pack([blob(0)])
    assert len(Matcher(packed.points, packed.mask).match(torch.zeros(0, 2), [0])[0].query) == 0


def test_refuses_what_it_does_not_know() -> None:
    with pytest.raises(InputError, match="'nearest', 'sinkhorn', 'hungarian', 'opencv'"):
        shape_distances([], [], "emd")
    with pytest.raises(InputError, match="Unknown setting epsilom"):
        shape_distances([], [], "sinkhorn", epsilom=1)
    with pytest.raises(InputError, match="direction_weight=0"):
        shape_distances([blob(0)], [blob(1)], direction_weight=1.0)
    with pytest.raises(InputError, match="at least one roll"):
        Matching(roll_deg=())
    with pytest.raises(ShapeError, match="give one a point"):
        shape_distances([blob(0)], [blob(1)], database_directions=[np.zeros(3)])
    with pytest.raises(InputError, match=">= 0"):
        shape_distances([blob(0)], [blob(1)], query_weights=[np.full(60, -1.0)])


def _name(method: object) -> str:
    return type(method).__name__.lower()


def _fields(method: object) -> dict:
    return {name: getattr(method, name) for name in type(method).__dataclass_fields__}  # type: ignore[attr-defined]
