"""Whether the track is at the right place: a two-state hidden Markov filter (right, wrong), picture by picture.

Tracks slip and are found again; between pictures the filter allows for both, and every picture weighs in with its
log-likelihood ratio. That the kidney is the right one at all is another question, see `own_kidney`.
"""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.tracking.belief import REGION_90
from ursnav_torch.tracking.own_kidney import KidneyEvidence
from ursnav_torch.tracking.settings import PlaceSettings

Array = NDArray[np.float64]
#: Middles, in standard deviations an axis, of twenty equal parts of a normal distribution in space (chi, 3).
_SHELLS = np.array([
    0.465, 0.687, 0.832, 0.950, 1.053, 1.148, 1.238, 1.324, 1.410, 1.495,
    1.582, 1.671, 1.763, 1.862, 1.969, 2.088, 2.226, 2.396, 2.628, 3.058,
])  # fmt: skip
#: The log-odds stay within these, so that neither is for ever.
_BOUNDS = (-5.0, 8.0)


_NOWHERE = np.zeros(0)


class PlaceTest:
    """Follows the probability that the track's place is the right one.

    Attributes:
        log_odds: of right against wrong.
    """

    def __init__(self, settings: PlaceSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """A place nobody has vouched for."""
        self.log_odds = self._settings.first

    @property
    def right(self) -> float:
        """Probability that the place is the right one."""
        return float(1 / (1 + np.exp(-self.log_odds)))

    def passed(self, seconds: float) -> None:
        """Allow for slips and finds over some seconds."""
        s, right = self._settings, self.right
        slipped, found = 1 - np.exp(-seconds / s.slip_s), 1 - np.exp(-seconds / s.found_s)
        after = right * (1 - slipped) + (1 - right) * found
        self.log_odds = float(np.log(after / (1 - after)))

    def llr(self, evidence: KidneyEvidence) -> float:
        """Log-likelihood ratio of one picture: for the pose that it was aligned at being the right one."""
        constant, score, lead, fit = self._settings.weights
        llr = constant + score * evidence.score + lead * evidence.lead + fit * evidence.fit
        return float(np.clip(llr, -self._settings.max_llr, self._settings.max_llr))

    def add(self, llr: float, seconds: float) -> None:
        """Weigh one picture, taken some seconds after the one before."""
        share = min(np.sqrt(seconds / self._settings.frame_s), 1.0)
        self.log_odds = float(np.clip(self.log_odds + share * llr, *_BOUNDS))


def region_sd_mm(
    right: float, sd_mm: float, elsewhere_mm: Array, weight: Array, anywhere_mm: Array = _NOWHERE, strayed: float = 0.0
) -> float:
    """Standard deviation an axis whose 90 % region is that of a belief together with the places it may be wrong for.

    Args:
        right: probability of the belief's place.
        sd_mm: the belief's standard deviation an axis.
        elsewhere_mm, weight: (M,) distances of the other hypotheses, and their probabilities.
        anywhere_mm, strayed: (V,) distances of places all over the lumen, and the probability, of the belief being
            wrong, that it may be any of these.
    """
    local = np.full(len(_SHELLS), right / len(_SHELLS))
    total = float(weight.sum())
    strayed = 1.0 if total == 0 else strayed if len(anywhere_mm) else 0.0
    other = (1 - right) * (1 - strayed) * weight / max(total, 1e-12)
    spread = np.full(len(anywhere_mm), (1 - right) * strayed / max(len(anywhere_mm), 1))
    away = np.concatenate([_SHELLS * sd_mm, elsewhere_mm, anywhere_mm])
    share = np.concatenate([local, other, spread])
    order = np.argsort(away)
    reached = np.cumsum(share[order])
    return float(away[order][min(int(np.searchsorted(reached, 0.9 * reached[-1])), len(order) - 1)]) / REGION_90


def calyx_set(calyx: int, right: float, others: NDArray[np.int64], weight: Array, level: float = 0.95) -> list[int]:
    """The fewest calyces, -1 for none, that hold the one observed with a probability, the most probable first.

    Args:
        calyx: that the belief observes.
        right: probability of the belief's place.
        others, weight: (M,) what the other hypotheses observe, and their probabilities.
        level: the probability asked for.
    """
    share = {calyx: right if weight.sum() > 0 else 1.0}
    for other, w in zip(others.tolist(), ((1 - right) * weight / max(weight.sum(), 1e-12)).tolist(), strict=True):
        share[other] = share.get(other, 0.0) + w
    chosen, reached = list[int](), 0.0
    for name, part in sorted(share.items(), key=lambda item: -item[1]):
        chosen.append(name)
        reached += part
        if reached >= level - 1e-9:
            break
    return chosen
