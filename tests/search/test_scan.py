"""The scan at every roll and tilt: the sign and the fineness of the roll, the weights, the views asked for."""

import numpy as np
import pytest
import torch

from ursnav_torch.geometry import rotation_angle
from ursnav_torch.search.scan import RollScan, tilts

SECTORS, RINGS, CHANNELS = 72, 4, 3


def maps(seed: int, roll: float = 0.0) -> torch.Tensor:
    """Smooth polar maps (C, R, A) of unit channels; turned content-wise by ``roll`` radians."""
    rng = np.random.default_rng(seed)
    angle = np.arange(SECTORS) / SECTORS * 2 * np.pi + roll
    k = np.arange(1, 6)[:, None]
    waves = np.concatenate([np.cos(k * angle), np.sin(k * angle)])
    found = torch.from_numpy(rng.normal(size=(CHANNELS, RINGS, len(waves))) @ waves).float()
    return found / found.flatten(1).norm(dim=1)[:, None, None]


@pytest.fixture(scope="module")
def scan() -> RollScan:
    return RollScan(torch.stack([maps(seed) for seed in range(6)]), torch.tensor([1.0, 0.5, 0.5]))


@pytest.mark.parametrize("sectors", [0.0, 0.2, 0.4, -0.3, 17.3, -20.45, 35.8])
def test_the_roll_is_found_between_sectors_with_its_sign(scan: RollScan, sectors: float) -> None:
    """A camera rolled by +r sees at angle a what the view sees at a + r."""
    roll = sectors / SECTORS * 2 * np.pi
    found = scan.scan(maps(2, roll)[None])
    assert int(found.score.argmax()) == 2
    assert float(found.roll[2]) == pytest.approx(roll, abs=0.06 / SECTORS * 2 * np.pi)
    assert (found.roll >= -np.pi).all() and (found.roll < np.pi).all()


def test_a_perfect_fit_scores_the_sum_of_the_weights(scan: RollScan) -> None:
    found = scan.scan(maps(4)[None])
    assert float(found.score[4]) == pytest.approx(2.0, abs=1e-5) and found.score[:4].max() < 1.9


def test_a_channel_of_no_weight_has_no_say() -> None:
    query, views = maps(0), torch.stack([maps(0), maps(1)])
    views[1, 0] = query[0]  # alike in the first channel alone
    first = RollScan(views, torch.tensor([1.0, 0.0, 0.0])).scan(query[None]).score
    rest = RollScan(views, torch.tensor([0.0, 1.0, 1.0])).scan(query[None]).score
    assert float(first[1]) == pytest.approx(float(first[0]), abs=1e-5) and rest[1] < 0.9 * rest[0]


def test_the_tilt_that_suits_each_view_is_told(scan: RollScan) -> None:
    query = torch.stack([maps(10), maps(3, 0.3), maps(11), maps(1)])
    found = scan.scan(query)
    assert found.tilt[3] == 1 and found.tilt[1] == 3
    assert float(found.roll[3]) == pytest.approx(0.3, abs=0.01)


def test_some_views_score_as_among_all(scan: RollScan) -> None:
    query, few = maps(7, 0.7)[None], torch.tensor([5, 0, 3])
    everyone, some = scan.scan(query), scan.scan(query, few)
    torch.testing.assert_close(some.score, everyone.score[few], atol=1e-5, rtol=0)
    torch.testing.assert_close(some.roll, everyone.roll[few], atol=1e-4, rtol=0)
    assert len(scan) == 6


def test_convention_tilts_are_rings_around_no_tilt() -> None:
    R = tilts(4.0, 2)
    assert R.shape == (1 + 6 + 12, 3, 3)
    np.testing.assert_allclose(R[0], np.eye(3))
    T = np.tile(np.eye(4), (19, 1, 1))
    T[:, :3, :3] = R
    np.testing.assert_allclose(np.degrees(rotation_angle(T, np.eye(4))), [0.0] + 6 * [4.0] + 12 * [8.0], atol=1e-6)
    axis = R[:, :, 2]  # where the tilted camera looks: around the axis evenly, and never rolled
    np.testing.assert_allclose(axis[1:7].mean(0)[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(R[:, 0, 1], R[:, 1, 0], atol=1e-9)
    assert tilts(4.0, 0).shape == (1, 3, 3)


def test_a_masked_scan_is_the_normalized_correlation_over_what_is_valid() -> None:
    """Of the very shift and view, computed by hand; what lies where nothing is valid does not matter."""
    views = torch.stack([maps(seed) for seed in range(6)])
    weight = torch.tensor([1.0, 0.5, 0.5])
    valid = torch.ones(RINGS, SECTORS)
    valid[:2, 10:45] = 0
    query = views[2] * valid
    query = torch.stack([query[0] / query[0].norm(), *(query[1:] / query[1:].norm())])
    found = RollScan(views, weight).scan(query[None], valid=valid[None])
    for view in range(6):
        there = views[view] * valid
        shift = round(float(found.roll[view]) / (2 * np.pi) * SECTORS)
        turned, seen = torch.roll(views[view], -shift, -1), valid
        there = turned * seen
        alike = (query[0] * there[0]).sum() / there[0].norm()
        alike = alike + 0.5 * (query[1:] * there[1:]).sum() / there[1:].norm()
        assert float(found.score[view]) >= 0.97 * float(alike) - 0.02
    assert int(found.score.argmax()) == 2 and abs(float(found.roll[2])) < 0.01
    assert float(found.score[2]) == pytest.approx(1 + 0.5 * 1.0, abs=0.02)


def test_where_all_is_valid_a_masked_scan_is_the_plain_one(scan: RollScan) -> None:
    query = maps(4, 0.7)[None]
    query = torch.cat([query[:, :1], query[:, 1:] / 2**0.5], 1)  # a pair of channels is of unit length together
    views = torch.stack([maps(seed) for seed in range(6)])
    views = torch.cat([views[:, :1], views[:, 1:] / 2**0.5], 1)
    scan = RollScan(views, torch.tensor([1.0, 0.5, 0.5]))
    plain, masked = scan.scan(query), scan.scan(query, valid=torch.ones(1, RINGS, SECTORS))
    torch.testing.assert_close(masked.score, plain.score, atol=1e-4, rtol=0)
    torch.testing.assert_close(masked.roll, plain.roll, atol=1e-3, rtol=0)


@pytest.mark.parametrize("masked", [False, True])
def test_a_first_look_is_the_scan_by_few_frequencies(scan: RollScan, masked: bool, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """These maps have five, so that ten are all of them and three are not."""
    query, valid = torch.stack([maps(4, 0.5), maps(9)]), None
    if masked:
        valid = torch.ones(2, RINGS, SECTORS)
        valid[:, :, 20:40] = 0
        query = query * valid[:, None]
    full = scan.scan(query, valid=valid).score
    tolerance = 0.02 if masked else 1e-5  # a mask has edges, of all frequencies
    torch.testing.assert_close(scan.first_look(query, valid=valid), full, atol=tolerance, rtol=0)
    torch.testing.assert_close(
        scan.first_look(query, torch.tensor([4, 1]), valid), full[[4, 1]], atol=tolerance, rtol=0
    )
    monkeypatch.setattr("ursnav_torch.search.scan.FEW_FREQUENCIES", 3)
    assert float((scan.first_look(query, valid=valid) - full).abs().max()) > 0.05
