"""Whether the pictures show the VID's kidney at all, or another one."""

from dataclasses import dataclass

import numpy as np

from ursnav_torch.tracking.settings import OwnKidneySettings


@dataclass(frozen=True, slots=True)
class KidneyEvidence:
    """What one picture says.

    Attributes:
        score: of the refined pose, for the picture as it was taken: what was learned as the scope's pattern makes
            pictures of another kidney fit, too.
        lead: by how much the views at that pose fit better than those anywhere else.
        fit: of the best view; where it is high there is much to be seen, and a true pose aligns well.
        decoy: score of the mirrored picture, which is asked while the kidney is in doubt; None else.
        off: standard deviations by which the pose misses the sensor's reading, None without one.
    """

    score: float
    lead: float
    fit: float
    decoy: float | None = None
    off: float | None = None

    def log_odds(self, settings: OwnKidneySettings) -> float:
        """That the picture shows the VID's kidney, within what a single picture may count."""
        s = settings
        constant, score, lead, fit = s.weights
        odds = constant + score * self.score + lead * self.lead + fit * self.fit
        if self.decoy is not None:
            doubt, decoy = s.doubt_weights
            odds += doubt + decoy * self.decoy
        if self.off is not None:
            odds += float(np.clip(s.sensor_gate_sd - self.off, -s.max_llr_against, s.max_llr_against))
        return float(np.clip(odds, -s.max_llr_against, s.max_llr_for))


class OwnKidneyTest:
    """A sequential test with bounds (Wald, Sequential tests of statistical hypotheses, 1945).

    Attributes:
        trust: the log-odds gathered so far, that this is the VID's kidney.
    """

    def __init__(self, settings: OwnKidneySettings) -> None:
        self._settings = settings
        self.trust = 0.0

    def add(self, evidence: KidneyEvidence, seconds: float) -> None:
        """Weigh one picture, taken some seconds after the one before."""
        s = self._settings
        gain = evidence.log_odds(s) * min(seconds, 4 * s.frame_s) / s.frame_s
        self.trust = float(np.clip(self.trust + gain, s.min_sum, s.max_sum))

    def leapt(self) -> None:
        """The place is another one: what spoke for the one before does not speak for it."""
        self.trust = min(self.trust, self._settings.after_leap)

    @property
    def in_doubt(self) -> bool:
        """Whether a picture's evidence needs a decoy."""
        return self.trust < self._settings.doubt_below

    @property
    def verdict(self) -> bool | None:
        """True when it is believed to be the VID's kidney, False when that is given up, None in between."""
        if self.trust <= self._settings.reject_below:
            return False
        return True if self.trust >= self._settings.accept_above else None
