"""Fitting the regressions of certainty to pictures whose truth is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ursnav_torch.localization.certainty import (
    FLOOR_DEG,
    FLOOR_MM,
    MOST_LOG_ODDS,
    Floats,
    Novelty,
    Regressions,
    answer_log_odds,
    both_hold,
    confidence_basis,
    error_basis,
    utilities,
)
from ursnav_torch.localization.evidence import LOOKS, NUMBERS, Evidence

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: What a picture of nothing shows: no answer is right.
NOTHING = -2
#: Share of errors within one standard deviation; of a normal distribution's.
WITHIN_SD = 0.6827
_RIDGE = 1.0
_QUANTILE_BEND = 0.05  # width over which the pinball loss is rounded, in logarithms of errors
_BORDER = np.array([1.0, 0.0])  # where the border's parameters begin, and what holds them: a weight of 1
_LOOKS_AT = [NUMBERS.index(name) for name in LOOKS]


@dataclass(frozen=True, slots=True)
class Asked:
    """Pictures that were located, M of them, and what is true.

    Attributes:
        evidence: (M) what was known of each.
        shown: (M,) calyx, -1 for none, `NOTHING` for a picture of nothing.
        position_mm, direction_deg: (M,) errors, mm at the kidney's scale 1; nan for a picture of nothing.
        kidney: (M,) which kidney, a number each.
        kind: (M,) which kind of picture.
    """

    evidence: Sequence[Evidence]
    shown: Rows
    position_mm: Array
    direction_deg: Array
    kidney: Rows
    kind: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.shown)

    def subset(self, keep: Mask) -> "Asked":
        """The pictures where ``keep`` (M,) is true."""
        return Asked(
            [e for e, k in zip(self.evidence, keep, strict=True) if k], self.shown[keep], self.position_mm[keep],
            self.direction_deg[keep], self.kidney[keep], self.kind[keep],
        )  # fmt: skip

    @property
    def answer(self) -> Rows:
        """(M,) calyx answered."""
        return np.array([e.answer for e in self.evidence], np.int64)

    @property
    def right(self) -> Mask:
        """(M,) which answers are right."""
        return np.asarray(self.answer == self.shown)

    @property
    def numbers(self) -> Array:
        """(M, N)."""
        return np.stack([e.numbers for e in self.evidence])


def fit_regressions(asked: Asked) -> Regressions:
    """The regressions of certainty, lightly regularized."""
    numbers = asked.numbers
    center, spread = numbers.mean(0), numbers.std(0) + 1e-3
    x = np.clip((numbers - center) / spread, -4, 4)
    calyces, alive = _padded(asked.evidence)
    calyx = _fit_calyx(calyces, alive, x, asked.shown)
    p = _softmax(utilities(calyx, calyces, x), alive)
    odds = answer_log_odds(p, asked.answer)
    basis = confidence_basis(x, odds)
    confidence, border = _fit_logistic(basis, numbers, asked.right)
    z = np.clip(both_hold(basis @ confidence, numbers, border), -MOST_LOG_ODDS, MOST_LOG_ODDS)
    known = np.isfinite(asked.position_mm)
    errors = error_basis(x[known], z[known])
    position = fit_quantile(errors, np.log(asked.position_mm[known] + FLOOR_MM))
    direction = fit_quantile(errors, np.log(asked.direction_deg[known] + FLOOR_DEG))
    parts = (center, spread, calyx, confidence, position, direction)
    plain = [plain_numbers(part) for part in parts]
    constant, weight = plain_numbers(border)
    return Regressions(plain[0], plain[1], plain[2], plain[3], (constant, weight), plain[4], plain[5], _novelty(x))


def fit_quantile(basis: Array, values: Array, share: float = WITHIN_SD) -> Array:
    """Weights (B,) of a basis (M, B) whose sum ``share`` of values (M,) do not exceed (Koenker and Bassett 1978)."""

    def loss(w: Array) -> tuple[float, Array]:
        over = values - basis @ w
        soft = _QUANTILE_BEND * np.logaddexp(0, over / _QUANTILE_BEND)
        slope = expit(over / _QUANTILE_BEND) - (1 - share)
        penalty = 0.02 * w
        penalty[0] = 0.0
        return float((soft - (1 - share) * over).sum() + 0.5 * penalty @ w), penalty - basis.T @ slope

    start = np.zeros(basis.shape[1])
    start[0] = np.quantile(values, share)
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B").x)


def _fit_calyx(calyces: Array, alive: Mask, x: Array, shown: Rows) -> Array:
    """Weights of the conditional logit (McFadden 1974) by maximum likelihood."""
    kinds, count = calyces.shape[2], calyces.shape[1] - 1
    true = np.where(shown == NOTHING, count + 1, np.where(shown < 0, count, shown))
    chosen = np.arange(len(x)), true

    def loss(w: Array) -> tuple[float, Array]:
        p = _softmax(utilities(w, calyces, x), alive)
        off = p.copy()
        off[chosen] -= 1
        own = np.einsum("mc,mcf->f", off[:, :-1], calyces)
        gradient = np.concatenate([own, [off[:, -2].sum(), off[:, -1].sum()], off[:, -1] @ x])
        return float(-np.log(p[chosen] + 1e-12).sum() + 0.5 * _RIDGE * w @ w), gradient + _RIDGE * w

    return np.asarray(minimize(loss, np.zeros(kinds + 2 + x.shape[1]), jac=True, method="L-BFGS-B").x)


def _fit_logistic(basis: Array, numbers: Array, right: Mask) -> tuple[Array, Array]:
    """Weights of `confidence_basis` (M, B), and the border's (2,), see `both_hold`, by maximum likelihood."""
    sign, size = np.where(right, 1.0, -1.0), basis.shape[1]
    ridge = np.full(size, _RIDGE)
    ridge[0] = 0.0

    def loss(w: Array) -> float:
        z = both_hold(basis @ w[:size], numbers, _border(w[size:]))
        prior = ridge @ w[:size] ** 2 + np.sum((w[size:] - _BORDER) ** 2)
        return float(np.logaddexp(0, -sign * z).sum() + 0.5 * prior)

    start = np.concatenate([np.zeros(size), _BORDER])
    start[size - 1] = 1.0
    w = minimize(loss, start, method="L-BFGS-B", options={"maxfun": 50_000}).x
    return w[:size], _border(w[size:])


def _border(w: Array) -> Array:
    """Constant and weight, which is positive, of parameters (2,)."""
    return np.array([w[0], np.exp(w[1])])


def _novelty(x: Array) -> Novelty:
    looks = x[:, _LOOKS_AT]
    value, axes = np.linalg.eigh(np.cov(looks.T) + 0.02 * np.eye(looks.shape[1]))
    whiten = (axes / np.sqrt(value)).T
    size = np.sqrt(np.mean((looks @ whiten.T) ** 2, axis=1))
    return Novelty(tuple(plain_numbers(row) for row in whiten), float(np.quantile(size, 0.95)), 0.5)


def _padded(evidence: Sequence[Evidence]) -> tuple[Array, Mask]:
    """Calyx numbers (M, C + 1, F) with the rows of none last, and which of C + 2 rows there are (M, C + 2)."""
    most, kinds = max(len(e.calyces) for e in evidence), evidence[0].calyces.shape[1]
    calyces, alive = np.zeros((len(evidence), most, kinds)), np.ones((len(evidence), most + 1), bool)
    for i, e in enumerate(evidence):
        count = len(e.calyces) - 1
        calyces[i, :count], calyces[i, -1] = e.calyces[:-1], e.calyces[-1]
        alive[i, count : most - 1] = False
    return calyces, alive


def _softmax(utility: Array, alive: Mask) -> Array:
    utility = np.where(alive, utility, -np.inf)
    odds = np.exp(utility - utility.max(1, keepdims=True))
    return np.asarray(odds / odds.sum(1, keepdims=True))


def expit(z: Array) -> Array:
    """The logistic function of log-odds (M,), in 0..1."""
    return np.asarray(1 / (1 + np.exp(-np.clip(z, -500, 500))))


def plain_numbers(values: Array) -> Floats:
    """Values (N,) as plain numbers of six digits, which are as good and shorter."""
    return tuple(float(f"{v:.6g}") for v in values)
