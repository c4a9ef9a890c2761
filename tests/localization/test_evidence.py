"""The numbers that certainty is computed from."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from ursnav_torch.localization.evidence import (
    CALYX_NUMBERS,
    FARTHEST,
    LOOKS,
    NUMBERS,
    REFINED_CALYX_NUMBERS,
    REFINED_NUMBERS,
    Vote,
    looks,
    nearest_evidence,
    refined_evidence,
    vote,
)
from ursnav_torch.search import Ranking

PICTURE = SimpleNamespace(contrast=-1.5, grain=0.2, fields=torch.zeros(0, 0, 0))


def said(distance: list[float], calyx: list[int], count: int = 5) -> Vote:
    return vote(np.array(distance), np.array(calyx), count)


def test_near_best_views_vote_and_a_distance_of_0_012_more_counts_an_e_th() -> None:
    seen = said([0.1, 0.112], [4, 2])
    assert seen.calyx == 4 and seen.share[4] == pytest.approx(1 / (1 + math.exp(-1)), abs=1e-3)
    assert said([0.1, 0.101, 0.101], [4, 2, 2]).calyx == 2  # two nearly as near outvote the nearest
    assert said([0.1, 0.2, 0.2, 0.2], [4, 2, 2, 2]).calyx == 4  # but far ones do not


def test_passages_vote_for_none_in_the_last_row() -> None:
    seen = said([0.1, 0.2], [-1, 3])
    assert seen.calyx == -1 and seen.share.argmax() == 5 and seen.share.sum() == pytest.approx(1.0)
    assert seen.best.tolist() == [np.inf, np.inf, np.inf, 0.2, np.inf, 0.1]


def ranking(distance: list[float], away_mm: float) -> Ranking:
    T = np.eye(4)[None].repeat(len(distance), 0)
    T[:, 0, 3] = away_mm * np.arange(len(distance))
    return Ranking(np.arange(len(distance)), 1 - np.array(distance), 1.0, T[:, :3, :3], T)


def test_the_numbers_are_distance_margin_odds_and_spread() -> None:
    found = ranking([0.1, 0.112], 3.0)
    e = nearest_evidence(found, said([0.1, 0.112], [4, 2]), PICTURE, 2.0)  # type: ignore[arg-type]
    assert len(e.numbers) == len(NUMBERS) - REFINED_NUMBERS
    assert e.calyces.shape == (6, len(CALYX_NUMBERS) - REFINED_CALYX_NUMBERS)
    share = 1 / (1 + math.exp(-1))
    spread = math.sqrt((1 - share) * 3.0**2) / 2.0
    np.testing.assert_allclose(e.numbers[:4], [0.1, 0.012, 1.0, math.log(spread + 0.05)], atol=1e-3)
    np.testing.assert_allclose(e.calyces[:, 1], [FARTHEST, FARTHEST, 0.012, FARTHEST, 0.0, FARTHEST], atol=1e-9)
    alone = nearest_evidence(ranking([0.1], 0.0), said([0.1], [0]), PICTURE, 1.0)  # type: ignore[arg-type]
    assert alone.numbers[1] == FARTHEST and np.isfinite(alone.numbers).all()  # no other calyx: as far as counts


def test_looks_tell_sharp_from_dull_and_relief_from_none() -> None:
    rng = np.random.default_rng(0)
    relief, slope = rng.normal(size=(1, 40, 40)), rng.normal(size=(2, 40, 40))
    relief[:, :10] = 0.0

    def of(fine: float) -> dict[str, float]:
        fields = torch.from_numpy(np.concatenate([relief, fine * slope, slope]))
        picture = SimpleNamespace(contrast=-1.5, grain=0.2, fields=fields)
        return dict(zip(LOOKS, looks(picture), strict=True))  # type: ignore[arg-type]

    dull, sharp = of(1.0), of(3.0)
    assert dull["flat"] == pytest.approx(0.25) and dull["sharpness"] == pytest.approx(0.0, abs=1e-6)
    assert sharp["sharpness"] == pytest.approx(math.log(3.0), abs=1e-3) and sharp["strength"] == dull["strength"]
    assert dull["strength"] == pytest.approx(0.0, abs=0.1) and dull["contrast"] == -1.5


def test_where_a_pose_stands_and_what_verification_says_count_for_each_calyx() -> None:
    rng, pixels = np.random.default_rng(0), 40
    drawing = SimpleNamespace(
        seen=np.ones(pixels), value=rng.normal(size=(3, pixels)), slope=rng.normal(size=(2, 3, pixels)),
        motion=rng.normal(size=(6, 2, pixels)),
    )  # fmt: skip
    refined = SimpleNamespace(
        score=0.7, tried_scores=np.array([0.7, 0.68, 0.6]), tried_log_odds=np.log([6.0, 3.0, 1.0]) + 50,
        drawing=drawing, T_kidney_camera=np.eye(4), T_start=np.eye(4),
    )  # fmt: skip
    nearest = nearest_evidence(ranking([0.1, 0.112], 3.0), said([0.1, 0.112], [4, 2]), PICTURE, 1.0)  # type: ignore[arg-type]
    firm = np.array([0.0, 0.0, 0.25, 0.0, 0.75, 0.0])
    observed = np.array([4, 4, 2, 4])
    e = refined_evidence(nearest, refined, observed, 4, firm, 1.0)  # type: ignore[arg-type]
    assert e.numbers.shape == (len(NUMBERS),) and e.calyces.shape == (6, len(CALYX_NUMBERS))
    of = dict(zip(NUMBERS, e.numbers, strict=True))
    assert of["firm"] == pytest.approx(math.log(3)) and of["verified"] == pytest.approx(math.log(7 / 3))
    share, told = (np.exp(e.calyces[:, CALYX_NUMBERS.index(name)]) for name in ("firm", "verified"))
    np.testing.assert_allclose(share[[2, 4]], [0.25, 0.75])
    np.testing.assert_allclose(told[[2, 4]], [0.3, 0.7])
    assert share[0] == told[0] == share[5] > 0  # nobody there: improbable, and still a number
