"""Calibrating certainty by pictures that its regressions did not see."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ursnav_torch.localization.certainty import (
    FLOOR_DEG,
    FLOOR_MM,
    LEVELS,
    CertaintyModel,
    Floats,
    Regressions,
    improbability,
)
from ursnav_torch.localization.fitting import WITHIN_SD, Asked, expit, fit_regressions, plain_numbers

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Groups of difficulty, as many pictures in each; fewer where there would be fewer than this in one.
GROUPS, LEAST_IN_GROUP = 6, 40
#: Log-odds taken off for novelty that are tried on kinds left out.
NOVELTY_WEIGHTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
#: How far a kidney's own slope and shift of the log-odds are expected from 1 and 0.
SLOPE_SD, SHIFT_SD = 0.15, 0.5
_THRESHOLDS = 200


def learn_certainty(asked: Asked, kinds_without: Callable[[str], Sequence[str]] | None = None) -> CertaintyModel:
    """Regressions of all pictures, calibrated by those of other kidneys' (cross-conformal: Vovk, AMAI 74:9, 2015).

    Args:
        asked: with at least a few right and a few wrong answers; of one kidney it is parted by chance.
        kinds_without: names the kinds of pictures that go when one kind is left out; novelty then is weighed by how
            it serves those left out. Not weighed, 0.5, when None.
    """
    regressions = fit_regressions(asked)
    novelty = regressions.novelty
    if kinds_without is not None:
        novelty = replace(novelty, weight=_novelty_weight(asked, kinds_without))
    regressions = replace(regressions, novelty=novelty)
    log_odds, own, off = _out_of_fold(asked, novelty.weight)
    return _calibrated(regressions, asked, log_odds, own, off)


def kidneys_own(model: CertaintyModel, asked: Asked) -> CertaintyModel:
    """A model of other kidneys, its log-odds stretched and shifted as far as one kidney's own pictures ask for it."""
    said = [model.regressions.log_odds(e, model.regressions.probabilities(e))[0] for e in asked.evidence]
    z, sign = np.array(said), np.where(asked.right, 1.0, -1.0)

    def loss(w: Array) -> float:
        prior = ((w[0] - 1) / SLOPE_SD) ** 2 + (w[1] / SHIFT_SD) ** 2
        return float(np.logaddexp(0, -sign * (w[0] * z + w[1])).sum() + 0.5 * prior)

    slope, shift = minimize(loss, np.array([1.0, 0.0]), method="BFGS").x
    return model.of_kidney(float(max(slope, 0.3)), float(shift))


def _novelty_weight(asked: Asked, kinds_without: Callable[[str], Sequence[str]]) -> float:
    """The weight that makes confidence likeliest on kinds of pictures left out."""
    loss = np.zeros(len(NOVELTY_WEIGHTS))
    for kind in np.unique(asked.kind):
        left_out = asked.subset(asked.kind == kind)
        plain = fit_regressions(asked.subset(~np.isin(asked.kind, kinds_without(str(kind)))))
        plain = replace(plain, novelty=replace(plain.novelty, weight=0.0))
        said = [plain.log_odds(e, plain.probabilities(e)) for e in left_out.evidence]
        z, excess = np.array(said).T
        sign = np.where(left_out.right, 1.0, -1.0)
        for i, weight in enumerate(NOVELTY_WEIGHTS):
            loss[i] += float(np.logaddexp(0, -sign * (z - weight * excess)).mean())
    return NOVELTY_WEIGHTS[int(loss.argmin())]


def _out_of_fold(asked: Asked, weight: float) -> tuple[Array, Array, Array]:
    """Of every picture, by regressions that did not see its kidney: log-odds (M,), the true calyx's improbability (M,),
    and by how much the logarithms of the errors exceed what was said (M, 2)."""
    fold = _folds(asked)
    z, own, off = np.zeros(len(asked)), np.zeros(len(asked)), np.full((len(asked), 2), np.nan)
    for k in np.unique(fold):
        fitted = fit_regressions(asked.subset(fold != k))
        fitted = replace(fitted, novelty=replace(fitted.novelty, weight=weight))
        for i in np.flatnonzero(fold == k).tolist():
            e = asked.evidence[i]
            p = fitted.probabilities(e)
            z[i] = fitted.log_odds(e, p)[0]
            own[i] = improbability(p, e.answer)[max(int(asked.shown[i]), -1)]
            errors = np.array([asked.position_mm[i] + FLOOR_MM, asked.direction_deg[i] + FLOOR_DEG])
            off[i] = np.log(errors) - fitted.log_sds(e, float(z[i]))
    return z, own, off


def _calibrated(regressions: Regressions, asked: Asked, z: Array, own: Array, off: Array) -> CertaintyModel:
    confidence = expit(z)
    groups = int(np.clip(len(z) // LEAST_IN_GROUP, 1, GROUPS))
    edges = np.quantile(confidence, np.arange(1, groups) / groups)
    group = np.searchsorted(edges, confidence, "right")
    sets = tuple(_levels(own[group == g]) for g in range(groups))
    shifts = []
    for g in range(groups):
        here = off[(group == g) & np.isfinite(off[:, 0])]
        mm, deg = np.quantile(here, WITHIN_SD, axis=0) if len(here) else (0.0, 0.0)
        shifts.append((float(mm), float(deg)))
    return CertaintyModel(
        regressions, 1.0, 0.0, plain_numbers(edges), sets, tuple(shifts), _accepted(confidence, asked.right)
    )


def _levels(own: Array) -> Floats:
    """Conformal quantiles of scores (K,) at `LEVELS`, with the finite-sample correction; 2, above every score, where
    the pictures are too few."""
    ranked, count = np.sort(own), len(own)
    rows = [int(np.ceil((count + 1) * level)) for level in LEVELS]
    return tuple(float(ranked[row - 1]) if row <= count else 2.0 for row in rows)


def _accepted(confidence: Array, right: Mask) -> tuple[tuple[float, int, int], ...]:
    """(T, 3) thresholds, how many pictures have at least that confidence, and how many of those are wrong."""
    order = np.argsort(-confidence, kind="stable")
    wrong = np.cumsum(~right[order])
    rows = np.unique(np.linspace(0, len(order) - 1, min(_THRESHOLDS, len(order))).astype(int))
    return tuple((float(confidence[order[i]]), int(i + 1), int(wrong[i])) for i in rows)


def _folds(asked: Asked) -> Rows:
    """(M,) the kidney, or one of four by chance where all are of one."""
    if len(np.unique(asked.kidney)) > 1:
        return asked.kidney
    return np.random.default_rng(0).permutation(len(asked)) % 4
