"""How sure: a calibrated probability that the calyx is right, learned when the VID is built."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ursnav_torch.features import Features

Array = NDArray[np.float64]

#: Width of the vote among near-best views: distances this much apart count 1 to e.
VOTE_WIDTH = 0.012
#: Numbers that refinement adds: the aligned score, and 1 where the refined pose observes the calyx that was voted for.
REFINED_NUMBERS = 2


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a ranking says about the calyx.

    Attributes:
        calyx: index with the most votes, -1 for none.
        distance: of its best view.
        margin: how much farther the best view of any other calyx is.
        vote: share of the votes, each near-best view voting with exp(-distance / VOTE_WIDTH).
        contrast, grain: of the picture, see `features.Features`.
    """

    calyx: int
    distance: float
    margin: float
    vote: float
    contrast: float
    grain: float

    def numbers(self) -> Array:
        """(5,) what confidence is computed from: distance, margin, log-odds of the vote, contrast, grain."""
        vote = min(max(self.vote, 1e-4), 1 - 1e-4)
        odds = math.log(vote / (1 - vote))
        return np.array([self.distance, min(self.margin, 0.15), odds, self.contrast, self.grain])


def evidence(distance: Array, calyx: NDArray[np.int64], features: Features) -> Evidence:
    """`Evidence` of a picture's views, with distances (K,) ascending, from which it observes calyces (K,)."""
    weight = vote_weight(distance, float(distance[0]))
    names, row = np.unique(calyx, return_inverse=True)
    votes = np.bincount(row, weight)
    best = int(votes.argmax())
    own, other = distance[row == best], distance[row != best]
    margin = float(other[0] - own[0]) if len(other) else 1.0
    return Evidence(
        int(names[best]), float(own[0]), margin, float(votes[best] / votes.sum()), features.contrast, features.grain
    )


def vote_weight(distance: Array, best: float) -> Array:
    """What views at distances (K,) count beside one at the distance ``best``: 1 to e for every `VOTE_WIDTH`."""
    return np.exp((best - distance) / VOTE_WIDTH)


@dataclass(frozen=True, slots=True)
class Confidence:
    """Logistic regression on the evidence (Platt 1999).

    Attributes:
        weights: intercept, then one a number; none where nothing was learned with the settings at hand.
    """

    weights: tuple[float, ...]

    @classmethod
    def from_calibration(
        cls, calibration: Mapping[str, object] | None, refined: bool, settings: str | None = None
    ) -> "Confidence":
        """From what the VID stored for answers with or without refinement; the plain vote without calibration.

        Args:
            calibration: of the VID.
            refined: whether answers are refined.
            settings: of the search, as `Localizer.evidence_settings` says them; what was learned with others says
                nothing of these. Not asked when None.
        """
        learned = (calibration or {}).get("confidence")
        if isinstance(learned, Mapping):
            if settings is not None and learned.get("settings") != settings:
                return cls(())
            return cls(tuple(float(w) for w in learned["refined" if refined else "nearest"]))
        return cls((0.0, 0.0, 0.0, 1.0, 0.0, 0.0) + (0.0,) * (REFINED_NUMBERS if refined else 0))

    def probability(self, numbers: Array) -> float:
        """Probability in 0..1 that the answer is right, from its evidence numbers (N,); 0 where one is not finite.

        nan where nothing was learned with the settings at hand.
        """
        if not self.weights:
            return math.nan
        if not np.all(np.isfinite(numbers)):
            return 0.0
        z = self.weights[0] + float(np.dot(self.weights[1:], numbers))
        return 1 / (1 + math.exp(-max(min(z, 30.0), -30.0)))


def fit(numbers: Array, right: NDArray[np.bool_]) -> Confidence:
    """Fit to evidence numbers (M, N) and whether each answer was right (M,); lightly regularized."""
    center, spread = numbers.mean(0), numbers.std(0) + 1e-6
    x = np.column_stack([np.ones(len(numbers)), (numbers - center) / spread])
    sign = np.where(right, 1.0, -1.0)

    def loss(w: Array) -> float:
        return float(np.logaddexp(0, -sign * (x @ w)).sum() + 0.5 * (w[1:] ** 2).sum())

    w = minimize(loss, np.zeros(x.shape[1]), method="BFGS").x
    slope = w[1:] / spread
    return Confidence((float(w[0] - slope @ center), *slope.tolist()))
