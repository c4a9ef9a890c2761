"""How sure: the probability that the calyx is right, the set that holds it, and how far off the pose may be."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.localization.evidence import LOOKS, NUMBERS, Evidence

Array = NDArray[np.float64]
Floats = tuple[float, ...]

#: Standardized numbers count no further than this: nothing was learned there, so nothing is extrapolated.
FARTHEST_SD = 4.0
#: Log-odds beyond this say no more.
MOST_LOG_ODDS = 8.0
#: Probabilities that sets are kept for; one in between is answered by the next above.
LEVELS = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.925, 0.95, 0.96, 0.97, 0.98, 0.99, 0.995)
#: Added to errors before their logarithm is taken, mm and degrees: what is smaller does not matter.
FLOOR_MM, FLOOR_DEG = 0.02, 0.1
_FIRM_AT = NUMBERS.index("firm")
_LOOKS_AT = slice(NUMBERS.index(LOOKS[0]), NUMBERS.index(LOOKS[0]) + len(LOOKS))


@dataclass(frozen=True, slots=True)
class Certainty:
    """How sure one answer is.

    Attributes:
        confidence: calibrated probability that the calyx answered is right.
        calyces: the smallest set that holds the right calyx with the probability asked for, the answer first, -1 for
            none.
        position_sd_mm, direction_sd_deg: two of three errors are within these.
        novelty: how much more unlike the pictures learned from this one is than nearly all of those are to each other,
            in standard deviations; 0 for one that is not.
    """

    confidence: float
    calyces: tuple[int, ...]
    position_sd_mm: float
    direction_sd_deg: float
    novelty: float


@dataclass(frozen=True, slots=True)
class Novelty:
    """How unlike anything learned a picture looks: Mahalanobis distance of its `LOOKS`.

    Attributes:
        whiten: (L, L) rows that make the standardized looks learned from white.
        usual: the root mean square of white looks that 95 of 100 learned ones stay below.
        weight: log-odds that confidence loses for every 1 beyond; chosen on kinds of pictures left out.
    """

    whiten: tuple[Floats, ...]
    usual: float
    weight: float

    def excess(self, x: Array) -> Array:
        """(M,) of standardized numbers (M, N), at least 0."""
        white = x[:, _LOOKS_AT] @ np.array(self.whiten).T
        return np.maximum(np.sqrt(np.mean(white**2, axis=1)) - self.usual, 0.0)


@dataclass(frozen=True, slots=True)
class Regressions:
    """What is computed from evidence; `learn_certainty` fits it.

    Attributes:
        center, spread: (N,) of the numbers.
        calyx: weights (F + 1 + 1 + N) of a conditional logit: the calyx numbers, a constant of "none", and constant
            and numbers of "nothing to be seen".
        confidence: weights (1 + N + 1) of a logistic regression (Platt 1999): constant, numbers, answer's log-odds.
        border: constant and weight of the number ``firm`` in the log-odds that a right pose names the right calyx.
        position, direction: weights (1 + N + 3) of the logarithm of the errors' 68 % quantile (Koenker and Bassett
            1978).
        novelty: how unlike the pictures learned from a picture is.
    """

    center: Floats
    spread: Floats
    calyx: Floats
    confidence: Floats
    border: tuple[float, float]
    position: Floats
    direction: Floats
    novelty: Novelty

    def standardized(self, numbers: Array) -> Array:
        """(M, N) numbers in standard deviations from what was learned, none beyond `FARTHEST_SD`."""
        return np.clip((numbers - np.array(self.center)) / np.array(self.spread), -FARTHEST_SD, FARTHEST_SD)

    def probabilities(self, evidence: Evidence) -> Array:
        """(C + 2,) of every calyx, of none, and of nothing to be seen."""
        x = self.standardized(evidence.numbers[None])[0]
        utility = utilities(np.array(self.calyx), evidence.calyces, x)
        odds = np.exp(utility - utility.max())
        return np.asarray(odds / odds.sum())

    def log_odds(self, evidence: Evidence, probabilities: Array) -> tuple[float, float]:
        """That the answer is right, and the novelty that was taken off it."""
        x = self.standardized(evidence.numbers[None])
        basis = confidence_basis(x, answer_log_odds(probabilities[None], np.array([evidence.answer])))
        excess = float(self.novelty.excess(x)[0])
        z = float(both_hold(basis @ np.array(self.confidence), evidence.numbers[None], self.border)[0])
        z -= self.novelty.weight * excess
        return float(np.clip(z, -MOST_LOG_ODDS, MOST_LOG_ODDS)), excess

    def log_sds(self, evidence: Evidence, log_odds: float) -> tuple[float, float]:
        """Logarithms of mm (at the kidney's scale 1) and degrees that two of three errors, floors added, are within."""
        basis = error_basis(self.standardized(evidence.numbers[None]), np.array([log_odds]))[0]
        return float(basis @ np.array(self.position)), float(basis @ np.array(self.direction))


@dataclass(frozen=True, slots=True)
class CertaintyModel:
    """Regressions and what pictures that they did not see say of them, within groups of difficulty.

    Attributes:
        regressions: confidence, probabilities and errors from evidence.
        slope, shift: of this kidney's log-odds against those of others (Platt 1999).
        edges: (G - 1,) confidences that part the groups, ascending.
        sets: (G, levels) for every one of `LEVELS`, how improbable a calyx may be to be in the set.
        log_sd_shift: (G, 2) what the errors' logarithms are off by.
        accepted: (T, 3) confidence, how many unseen pictures had at least that, and how many of them were wrong.
    """

    regressions: Regressions
    slope: float
    shift: float
    edges: Floats
    sets: tuple[Floats, ...]
    log_sd_shift: tuple[tuple[float, float], ...]
    accepted: tuple[tuple[float, int, int], ...]

    def certainty(self, evidence: Evidence, set_probability: float, scale: float = 1.0) -> Certainty:
        """How sure an answer is; ``scale`` is the kidney's. Evidence that is not finite is worth nothing."""
        if not (np.all(np.isfinite(evidence.numbers)) and np.all(np.isfinite(evidence.calyces))):
            every = [evidence.answer, *range(len(evidence.calyces) - 1), -1]
            return Certainty(0.0, tuple(dict.fromkeys(every)), np.nan, np.nan, np.inf)
        p = self.regressions.probabilities(evidence)
        z, novelty = self.regressions.log_odds(evidence, p)
        confidence = float(1 / (1 + np.exp(-(self.slope * z + self.shift))))
        group = int(np.searchsorted(self.edges, confidence, "right"))
        calyces = conformal_set(p, evidence.answer, self._most_improbable(group, set_probability))
        mm, deg = (
            float(np.exp(log + off))
            for log, off in zip(self.regressions.log_sds(evidence, z), self.log_sd_shift[group], strict=True)
        )
        mm, deg = max(mm - FLOOR_MM, FLOOR_MM), max(deg - FLOOR_DEG, FLOOR_DEG)
        return Certainty(confidence, calyces, mm * scale, min(deg, 180.0), novelty)

    def threshold(self, risk: float) -> float:
        """The lowest confidence from which on at most ``risk`` of answers are wrong, by an upper bound on unseen ones.

        Where the pictures were too few to prove it, an answer must itself be that probable.
        """
        found = [t for t, above, wrong in self.accepted if risk_bound(wrong, above) <= risk]
        return min(found, default=1 - risk)

    def of_kidney(self, slope: float, shift: float) -> "CertaintyModel":
        """The model for a kidney whose own pictures asked for another slope and shift of the log-odds."""
        return replace(self, slope=slope, shift=shift)

    def _most_improbable(self, group: int, probability: float) -> float:
        row = int(np.searchsorted(LEVELS, probability - 1e-9))
        return self.sets[group][row] if row < len(LEVELS) else np.inf


def risk_bound(wrong: int, count: int) -> float:
    """Upper bound of the share that is wrong, in expectation, from ``wrong`` of ``count`` unseen ones: conformal risk
    control (Angelopoulos et al., ICLR 2024), the next one counted as wrong."""
    return (wrong + 1) / (count + 1)


def conformal_set(probabilities: Array, answer: int, most_improbable: float) -> tuple[int, ...]:
    """The answer and every calyx, -1 for none, that is not too improbable, by probability.

    Args:
        probabilities: (C + 2,) as `Regressions.probabilities` gives them.
        answer: calyx that is in every set.
        most_improbable: bound of `improbability`.
    """
    own = improbability(probabilities, answer)
    count = len(probabilities) - 2
    named = [int(i) if i < count else -1 for i in np.argsort(own, kind="stable")]
    return tuple(c for c in named if own[c] <= most_improbable or c == answer)


def improbability(probabilities: Array, answer: int) -> Array:
    """(C + 1,) 1 - p of every calyx and of none (passages and pictures of nothing), -1 for the answer: it is in every
    set. The least ambiguous sets have 1 - p (Sadinle, Lei and Wasserman, JASA 114:223, 2019)."""
    p = np.append(probabilities[:-2], probabilities[-2:].sum())
    own = 1 - p
    own[answer] = -1.0
    return own


def utilities(weights: Array, calyces: Array, x: Array) -> Array:
    """Utilities (..., C + 2) from calyx numbers (..., C + 1, F) and standardized numbers (..., N)."""
    kinds = calyces.shape[-1]
    each = calyces @ weights[:kinds]
    each[..., -1] += weights[kinds]
    nothing = weights[kinds + 1] + x @ weights[kinds + 2 :]
    return np.concatenate([each, nothing[..., None]], axis=-1)


def answer_log_odds(probabilities: Array, answer: NDArray[np.int64]) -> Array:
    """(M,) log-odds of answers in probabilities (M, C + 2); padding is allowed before the last two."""
    row = np.where(answer >= 0, answer, probabilities.shape[1] - 2)
    p = np.clip(probabilities[np.arange(len(answer)), row], 1e-4, 1 - 1e-4)
    return np.log(p / (1 - p))


def confidence_basis(x: Array, log_odds: Array) -> Array:
    """(M, 1 + N + 1) a constant, standardized numbers (M, N) and the answer's log-odds (M,)."""
    return np.column_stack([np.ones(len(x)), x, log_odds])


def both_hold(place_log_odds: Array, numbers: Array, border: tuple[float, float] | Array) -> Array:
    """(M,) log-odds that the place is right and that the label is: an answer fails where either does.

    Sums would let a good fit make up for a pose on the border of two calyces; it doesn't, so the odds of failing add.

    Args:
        place_log_odds: (M,) of the place.
        numbers: (M, N) of evidence; without the alignment's nothing is known of the border.
        border: see `Regressions`.
    """
    if numbers.shape[1] <= _FIRM_AT:
        return place_log_odds
    return -np.logaddexp(-place_log_odds, -(border[0] + border[1] * numbers[:, _FIRM_AT]))


def error_basis(x: Array, log_odds: Array) -> Array:
    """(M, 1 + N + 3) a constant, standardized numbers, and log-odds that the answer is right, bent at even and 80 %:
    where one in three answers is wrong, errors jump from a millimeter to the next calyx."""
    bent = [np.maximum(0.0, at - log_odds) for at in (1.4, 0.0)]
    return np.column_stack([np.ones(len(x)), x, log_odds, *bent])
