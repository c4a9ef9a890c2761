"""Confidence, sets and standard deviations hold what they promise on pictures that nothing was learned from."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.localization.population import CALYCES, made_up
from ursnav_torch.localization.calibrating import kidneys_own, learn_certainty
from ursnav_torch.localization.certainty import LEVELS, Certainty, CertaintyModel, both_hold, conformal_set, risk_bound
from ursnav_torch.localization.evidence import LOOKS, NUMBERS, REFINED_NUMBERS
from ursnav_torch.localization.fitting import Asked, fit_quantile


@pytest.fixture(scope="module")
def model() -> CertaintyModel:
    return learn_certainty(made_up(1500))


@pytest.fixture(scope="module")
def unseen() -> Asked:
    return made_up(1500, seed=1)


def said(model: CertaintyModel, asked: Asked, probability: float = 0.95) -> list[Certainty]:
    return [model.certainty(e, probability) for e in asked.evidence]


def test_confidence_is_the_share_that_is_right(model: CertaintyModel, unseen: Asked) -> None:
    confidence = np.array([s.confidence for s in said(model, unseen)])
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        here = (confidence >= low) & (confidence < low + 0.2)
        assert unseen.right[here].mean() == pytest.approx(confidence[here].mean(), abs=0.09)


@pytest.mark.parametrize("probability", [0.8, 0.9, 0.95])
def test_sets_hold_the_right_calyx_as_often_as_asked_among_the_hard_ones_too(
    model: CertaintyModel, unseen: Asked, probability: float
) -> None:
    told = said(model, unseen, probability)
    held = np.array([max(int(s), -1) in t.calyces for s, t in zip(unseen.shown, told, strict=True)])
    size, confidence = np.array([len(t.calyces) for t in told]), np.array([t.confidence for t in told])
    hard = confidence < np.quantile(confidence, 0.25)
    assert held.mean() >= probability - 0.02 and held[hard].mean() >= probability - 0.05
    assert size.mean() < 0.6 * (CALYCES + 1) and size[hard].mean() > size[~hard].mean()


def test_the_answer_is_first_and_a_higher_probability_never_has_a_smaller_set(
    model: CertaintyModel, unseen: Asked
) -> None:
    for e in unseen.evidence[:50]:
        sets = [model.certainty(e, p).calyces for p in (0.5, 0.8, 0.95, 0.999)]
        assert all(s[0] == e.answer and len(set(s)) == len(s) for s in sets)
        assert all(set(a) <= set(b) for a, b in pairwise(sets))
        assert set(sets[-1]) == set(range(-1, CALYCES))  # beyond what so few pictures can promise: any


def test_pictures_of_nothing_have_none_in_their_set(model: CertaintyModel, unseen: Asked) -> None:
    nothing = [e for e, kind in zip(unseen.evidence, unseen.kind, strict=True) if kind == "none"]
    told = [model.certainty(e, 0.95) for e in nothing]
    assert np.mean([-1 in t.calyces for t in told]) >= 0.93
    assert np.mean([t.confidence for t in told]) < 0.2


def test_two_of_three_errors_are_within_one_standard_deviation(model: CertaintyModel, unseen: Asked) -> None:
    told, known = said(model, unseen), np.isfinite(unseen.position_mm)
    mm, deg = (np.array([getattr(t, name) for t in told]) for name in ("position_sd_mm", "direction_sd_deg"))
    for errors, sd in ((unseen.position_mm, mm), (unseen.direction_deg, deg)):
        assert 0.62 < np.mean(errors[known] <= sd[known]) < 0.74
    easy = mm < np.median(mm)
    assert np.nanmedian(unseen.position_mm[easy]) < 0.7 * np.nanmedian(unseen.position_mm[~easy])


def test_lengths_are_of_the_kidney_at_hand(model: CertaintyModel, unseen: Asked) -> None:
    anatomy, printed = (model.certainty(unseen.evidence[0], 0.95, scale) for scale in (1.0, 1.8))
    assert printed.position_sd_mm == pytest.approx(1.8 * anatomy.position_sd_mm)
    assert printed.direction_sd_deg == anatomy.direction_sd_deg


@pytest.mark.parametrize("risk", [0.01, 0.05, 0.1])
def test_of_the_accepted_no_more_are_wrong_than_the_risk(model: CertaintyModel, unseen: Asked, risk: float) -> None:
    accepted = np.array([s.confidence for s in said(model, unseen)]) >= model.threshold(risk)
    wrong = ~unseen.right[accepted]
    assert accepted.mean() > 0.05 and wrong.mean() <= risk + 0.01


def test_a_smaller_risk_asks_for_more_confidence(model: CertaintyModel) -> None:
    thresholds = [model.threshold(risk) for risk in (0.3, 0.1, 0.03, 0.01)]
    assert thresholds == sorted(thresholds) and thresholds[0] < thresholds[-1]
    unproven = replace(model, accepted=((0.99, 20, 0),))
    assert unproven.threshold(0.01) == 0.99 and unproven.threshold(0.2) == 0.8 + 0.19  # 20 right ones prove 5 %


def test_the_risks_bound_counts_the_next_answer_as_wrong() -> None:
    assert risk_bound(0, 99) == pytest.approx(0.01) and risk_bound(2, 299) == pytest.approx(0.01)
    assert risk_bound(0, 0) == 1.0 and risk_bound(3, 99) > 0.03


def test_what_looks_like_nothing_learned_from_is_believed_less(model: CertaintyModel, unseen: Asked) -> None:
    sure = max(unseen.evidence[:200], key=lambda e: model.certainty(e, 0.95).confidence)
    strange = sure.numbers.copy()
    at = [NUMBERS.index(name) for name in LOOKS]
    strange[at] = [9.0, -9.0, 9.0, -9.0, 9.0, -9.0]
    here, there = model.certainty(sure, 0.95), model.certainty(replace(sure, numbers=strange), 0.95)
    assert here.novelty < 0.5 < there.novelty
    plain = replace(model, regressions=replace(model.regressions, novelty=replace(model.regressions.novelty, weight=0)))
    assert there.confidence < plain.certainty(replace(sure, numbers=strange), 0.95).confidence


def test_what_is_not_a_number_is_worth_nothing(model: CertaintyModel, unseen: Asked) -> None:
    e = unseen.evidence[0]
    told = model.certainty(replace(e, numbers=np.full(len(NUMBERS), np.nan)), 0.95)
    assert told.confidence == 0.0 and set(told.calyces) == set(range(-1, CALYCES)) and np.isnan(told.position_sd_mm)


def test_a_kidney_whose_answers_are_worse_is_believed_less(model: CertaintyModel) -> None:
    worse = made_up(300, seed=2, shift=1.5)
    own = kidneys_own(model, worse)
    assert own.shift < -0.5
    before, after = (np.mean([s.confidence for s in said(m, worse)]) for m in (model, own))
    assert abs(after - worse.right.mean()) < abs(before - worse.right.mean())
    same = kidneys_own(model, made_up(300, seed=3))
    assert abs(same.shift) < 0.5 and same.slope == pytest.approx(1.0, abs=0.3)


def test_conformal_sets_are_the_answer_and_what_is_probable_enough() -> None:
    p = np.array([0.5, 0.3, 0.05, 0.05, 0.1])  # three calyces, passage, nothing: none has 0.15
    assert conformal_set(p, 1, 0.2) == (1,)
    assert conformal_set(p, 1, 0.5) == (1, 0)
    assert conformal_set(p, 0, 0.86) == (0, 1, -1)
    assert conformal_set(p, -1, 2.0) == (-1, 0, 1, 2)


def test_quantile_regression_leaves_the_share_asked_for_above() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=3000)
    y = 2 * x + rng.normal(size=3000)
    basis = np.column_stack([np.ones(3000), x])
    for share in (0.3, 0.6827):
        w = fit_quantile(basis, y, share)
        assert np.mean(y <= basis @ w) == pytest.approx(share, abs=0.01) and w[1] == pytest.approx(2.0, abs=0.1)


def test_levels_ascend() -> None:
    assert list(LEVELS) == sorted(LEVELS)


def test_a_pose_on_the_border_of_two_calyces_is_not_made_sure_by_a_good_fit() -> None:
    numbers = np.zeros((3, len(NUMBERS)))
    numbers[:, NUMBERS.index("firm")] = [5.0, 0.0, -3.0]
    for place in (2.0, 8.0):
        z = both_hold(np.full(3, place), numbers, (0.0, 1.0))
        assert np.all(np.diff(z) < 0) and z[1] < 0.0 and z[2] < -3.0 and z[0] < place
    odds = np.exp(-both_hold(np.array([1.0]), numbers[:1], (0.5, 2.0)))
    assert odds == pytest.approx(np.exp(-1.0) + np.exp(-10.5))  # odds of failing add
    nearest = numbers[:, :-REFINED_NUMBERS]
    np.testing.assert_array_equal(both_hold(np.array([2.0, 8.0, 1.0]), nearest, (0.0, 1.0)), [2.0, 8.0, 1.0])
