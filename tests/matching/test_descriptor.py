import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from matching_shapes import blob, rotated, tangents
from scipy.spatial.distance import pdist

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching import PointSets, ShapeContext, describe, fix_scale, mean_distances, pack
from ursnav_torch.matching.point_sets import pack_rows

SETTINGS = ShapeContext(scale=60.0)


def described(*sets: np.ndarray, settings: ShapeContext = SETTINGS, **rows: torch.Tensor) -> torch.Tensor:
    packed = pack(sets)
    return describe(packed.points, packed.mask, settings, **rows)


def by_hand(
    points: np.ndarray, settings: ShapeContext, reference: np.ndarray | None = None, weights: np.ndarray | None = None
) -> np.ndarray:
    """One loop a pair, written from the definition."""
    weights = np.ones(len(points)) if weights is None else weights
    edges = settings.radii().numpy()
    phase = 0.25 if reference is None else 0.5
    out = np.zeros((len(points), settings.radial_bins, settings.angular_bins))
    for i, p in enumerate(points):
        for q, weight in zip(points, weights, strict=True):
            r = np.hypot(*(q - p)) / settings.scale
            if r < 1e-5 or r >= edges[-1]:
                continue
            angle = math.atan2(q[1] - p[1], q[0] - p[0]) - (0 if reference is None else reference[i])
            sector = math.floor(angle / math.tau * settings.angular_bins + phase) % settings.angular_bins
            out[i, int(np.searchsorted(edges, r, side="right")), sector] += weight
    total = out.sum((1, 2), keepdims=True)
    return np.where(total > 0, out / np.where(total > 0, total, 1), 1 / settings.size).reshape(len(points), -1)


def test_agrees_with_the_definition() -> None:
    points = blob(0).astype(np.float32)
    np.testing.assert_allclose(described(points)[0].numpy(), by_hand(points, SETTINGS), atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 30, 31])
@pytest.mark.parametrize("sectors", [1, 7, 12])
@pytest.mark.parametrize("frame", ["absolute", "tangent"])
def test_every_pair_counts_once_at_either_end(count: int, sectors: int, frame: str) -> None:
    """Pairs are computed once for both of their points: odd and even numbers of points, weights, padding, doubles."""
    rng = np.random.default_rng(count)
    settings = ShapeContext(4, sectors, scale=60.0, frame=frame)  # type: ignore[arg-type]
    sets = [rng.uniform(0, 90, (n, 2)).astype(np.float32) for n in (count, 17)]
    if count > 2:
        sets[0][2] = sets[0][0]  # at one place: they do not see each other
    weights, along = ([rng.uniform(0.2, 3, len(s)).astype(np.float32) for s in sets] for _ in range(2))
    packed = pack(sets)
    tangents = pack_rows(along, packed)
    plain = describe(packed.points, packed.mask, settings, tangents)
    weighed = describe(packed.points, packed.mask, settings, tangents, pack_rows(weights, packed))
    for i, points in enumerate(sets):
        reference = along[i] if frame == "tangent" else None
        for found, each in ((plain[i], None), (weighed[i], weights[i])):
            wanted = by_hand(points, settings, reference, each)
            np.testing.assert_allclose(found[: len(points)].numpy(), wanted, atol=1e-6)
            assert found[len(points) :].abs().sum() == 0


def test_mean_distances_are_those_of_all_pairs() -> None:
    sets = [blob(3, n).astype(np.float32) for n in (2, 9, 10, 60)]
    packed = pack(sets)
    wanted = [pdist(points.astype(float)).mean() for points in sets]
    np.testing.assert_allclose(mean_distances(packed.points, packed.mask).numpy(), wanted, rtol=1e-5)
    assert mean_distances(packed.points, packed.mask.logical_and(torch.tensor(False))).isnan().all()


def test_many_sets_are_as_each_alone() -> None:
    """More sets than fit the cache at once."""
    sets = torch.from_numpy(np.stack([blob(seed, 100) for seed in range(23)])).float()
    mask = torch.ones(sets.shape[:2], dtype=torch.bool)
    alone = torch.cat([describe(s[None], m[None], SETTINGS) for s, m in zip(sets, mask, strict=True)])
    torch.testing.assert_close(describe(sets, mask, SETTINGS), alone)


def test_tangent_frame_agrees_with_the_definition() -> None:
    points = blob(1).astype(np.float32)
    settings = ShapeContext(scale=60.0, frame="tangent")
    along = tangents(points).astype(np.float32)
    found = described(points, settings=settings, tangents=torch.from_numpy(along)[None])
    np.testing.assert_allclose(found[0].numpy(), by_hand(points, settings, along), atol=1e-6)


def test_padding_and_neighbors_in_the_batch_change_nothing() -> None:
    short, long = blob(2, 20), blob(3, 50)
    both = described(short, long)
    torch.testing.assert_close(both[0, :20], described(short)[0])
    assert both[0, 20:].abs().sum() == 0


def test_rows_sum_to_one_also_without_neighbors() -> None:
    sets = [blob(4, 30), np.array([[3.0, 4.0]]), np.array([[0.0, 0.0], [9000.0, 0.0]])]
    packed = pack(sets)
    torch.testing.assert_close(describe(packed.points, packed.mask, SETTINGS).sum(2), packed.mask.float())


def test_permutation_permutes_the_rows() -> None:
    points, order = blob(5), np.random.default_rng(0).permutation(60)
    torch.testing.assert_close(described(points)[0, torch.from_numpy(order)], described(points[order])[0])


def test_a_weight_of_two_is_a_second_point_there() -> None:
    points = blob(6, 30)
    weights = torch.ones(1, 30)
    weights[0, 7] = 2
    twice = described(np.vstack([points, points[7:8]]))[0, :30]
    rows = [i for i in range(30) if i != 7]  # point 7 does not see itself, nor its double
    torch.testing.assert_close(described(points, weights=weights)[0, rows], twice[rows])


def test_a_turn_by_whole_sectors_moves_the_histogram_round() -> None:
    points = blob(7)
    for sectors in (1, 5, 6, 11):
        turned = described(rotated(points, sectors * math.tau / 12))[0].view(-1, 5, 12)
        moved = described(points)[0].view(-1, 5, 12).roll(sectors, 2)
        assert (turned - moved).abs().sum(2).mean() < 0.02  # some neighbors lie on a border and flip


def test_every_neighbor_in_reach_falls_into_a_bin_in_any_direction() -> None:
    angles = np.arange(-720, 721) * math.pi / 720
    spokes = np.stack([np.cos(angles), np.sin(angles)], -1) * 30
    for reference in (-math.tau, -math.pi, 0.0, 1.0, math.pi, math.tau):
        settings = ShapeContext(scale=60.0, frame="tangent", radial_bins=2)
        for spoke in spokes[::90]:
            both = np.stack([np.zeros(2), spoke])
            row = described(both, settings=settings, tangents=torch.full((1, 2), reference))[0, 0]
            assert row.max() == 1


def test_scale_names() -> None:
    square = np.array([[0, 0], [0, 3], [4, 0]], float)
    packed = pack([square, 2 * square, square[:1]])
    assert mean_distances(packed.points, packed.mask)[:2].tolist() == pytest.approx([4, 8])
    assert fix_scale(ShapeContext(), packed.points, packed.mask).scale == pytest.approx(6)
    assert fix_scale(SETTINGS, packed.points, packed.mask) is SETTINGS


def test_own_scale_is_invariant_to_scale() -> None:
    points = blob(8)
    both = described(points, 3.7 * points, settings=ShapeContext(scale="own"))
    assert (both[0] - both[1]).abs().sum(1).mean() < 0.01


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"radial_bins": 1}, "at least 2 radial bins"),
        ({"r_inner": 2.0}, "0 < r_inner < r_outer"),
        ({"frame": "polar"}, "'absolute' and 'tangent'"),
        ({"scale": "mean"}, "a number of px, 'database' and 'own'"),
        ({"scale": -1.0}, "a number of px"),
    ],
)
def test_refuses_settings(settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ShapeContext(**settings)


def test_refuses_what_does_not_fit() -> None:
    packed: PointSets = pack([blob(9)])
    with pytest.raises(InputError, match="fix_scale"):
        describe(packed.points, packed.mask, ShapeContext())
    with pytest.raises(InputError, match="edge direction"):
        describe(packed.points, packed.mask, ShapeContext(scale=1.0, frame="tangent"))
    with pytest.raises(ShapeError, match=r"points \(B, P, 2\)"):
        describe(packed.points[0], packed.mask, SETTINGS)
    with pytest.raises(ShapeError, match="weights must have shape"):
        describe(packed.points, packed.mask, SETTINGS, weights=torch.ones(1, 3))
    with pytest.raises(ShapeError, match=r"shape \(N, 2\)"):
        pack([np.zeros((4, 3))])
    with pytest.raises(InputError, match="not finite"):
        pack([np.array([[0.0, np.nan]])])


def test_memory_that_is_kept_changes_no_later_answer() -> None:
    """Other numbers of points, bins and sets in between, in and out of inference mode, in another thread."""
    other = ShapeContext(3, 8, scale=40.0)
    first, second = described(blob(1), blob(2)), described(blob(3, 33), settings=other)
    with torch.inference_mode():
        torch.testing.assert_close(described(blob(1), blob(2)).clone(), first)
        torch.testing.assert_close(described(blob(3, 33), settings=other).clone(), second)
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(lambda seed: described(blob(seed)), [1, 2] * 20))
    for found, wanted in zip(both, [0, 1] * 20, strict=True):
        torch.testing.assert_close(found[0], first[wanted])
    torch.testing.assert_close(described(blob(1), blob(2)), first)
