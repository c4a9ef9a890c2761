"""Whether the pictures show the VID's kidney at all, or another one."""

import numpy as np

from ursnav_torch.localization.track_search import TrackSettings


class OwnKidneyTest:
    """A sequential test with bounds (Wald, Sequential tests of statistical hypotheses, 1945).

    Attributes:
        trust: the log-odds gathered so far, that this is the VID's kidney.
    """

    def __init__(self, settings: TrackSettings) -> None:
        self._settings = settings
        self.trust = 0.0

    def add(self, score: float, agree: float, off: float | None, seconds: float) -> None:
        """Weigh one picture.

        Args:
            score: of the refined pose, for the picture as it was taken: what was learned as the scope's pattern makes
                pictures of another kidney fit, too.
            agree: share of the hypotheses' probability that agrees with that pose.
            off: standard deviations by which the pose misses the sensor's reading, if there is one.
            seconds: since the picture before.
        """
        s = self._settings
        odds = s.own_kidney[0] + s.own_kidney[1] * score + s.own_kidney[2] * agree
        if off is not None:
            odds += float(np.clip(s.own_sensor - off, -s.most, s.most))
        gain = float(np.clip(odds, -s.most, s.most_gain)) * min(seconds, 4 * s.usual_s) / s.usual_s
        self.trust = float(np.clip(self.trust + gain, -s.debt, s.credit))

    @property
    def verdict(self) -> bool | None:
        """True when it is believed to be the VID's kidney, False when that is given up, None in between."""
        if self.trust <= -self._settings.give_up:
            return False
        return True if self.trust >= self._settings.believe else None
