"""Made-up pictures whose evidence tells, by a known law, how likely the answer is right and how far off it is."""

import numpy as np

from ursnav_torch.localization.evidence import CALYX_NUMBERS, NUMBERS, Evidence
from ursnav_torch.localization.fitting import NOTHING, Asked

CALYCES = 5
_SCORE, _DISTANCE, _FIRM = (NUMBERS.index(name) for name in ("score", "distance", "firm"))


def made_up(count: int, seed: int = 0, shift: float = 0.0, kidneys: int = 3) -> Asked:
    """``count`` pictures; ``shift`` is taken off the log-odds that answers are right, unseen in the evidence."""
    rng = np.random.default_rng(seed)
    evidence, shown, mm = [], np.zeros(count, np.int64), np.full(count, np.nan)
    for i in range(count):
        nothing, ease = rng.random() < 0.1, rng.normal(2.5, 2.0)
        right = not nothing and rng.random() < 1 / (1 + np.exp(shift - ease))
        answer, true = (int(v) for v in rng.permutation(np.arange(-1, CALYCES))[:2])
        shown[i] = NOTHING if nothing else answer if right else true
        numbers = rng.normal(size=len(NUMBERS))
        numbers[_SCORE], numbers[_DISTANCE] = ease, 4.0 * nothing + rng.normal()
        numbers[_FIRM] = 12.0  # nobody stands on a border
        calyces = rng.normal(0.0, 0.3, (CALYCES + 1, len(CALYX_NUMBERS)))
        calyces[answer, 0] += 2.0 + 0.5 * ease
        if not nothing:
            mm[i] = np.exp(rng.normal(-0.3 * ease, 0.5))
            calyces[true, 0] += 2.0
        evidence.append(Evidence(answer, numbers, calyces))
    kind = np.array(["none" if s == NOTHING else f"kind {i % 2}" for i, s in enumerate(shown)])
    return Asked(evidence, shown, mm, 5 * mm, np.arange(count) % kidneys, kind)
