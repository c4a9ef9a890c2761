"""The Bayesian filter over the VID's views: what was known before, and what a picture says, in one distribution."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import Features
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.search import ViewSearch
from ursnav_torch.search.pose_mean import mean_pose
from ursnav_torch.tracking.motion import Hypotheses, Since
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import FilterSettings

Array = NDArray[np.float64]
_NEGLIGIBLE = 1e-6  # hypotheses of less probability are not carried on


class ViewFilter:
    """The views of a VID, weighed against one picture after the other.

    Args:
        search: compares a picture with the VID's views.
        places_mm: (V, 3) where the views stand, kidney frame.
        lumen: distances in their kidney.
        settings: how to weigh, lengths in mm of this kidney (see `scaled`).
        spacing_mm: how coarse the poses compared are.
    """

    def __init__(
        self, search: ViewSearch, places_mm: Array, lumen: LumenDistance, settings: FilterSettings, spacing_mm: float
    ) -> None:
        self.search, self.settings, self._spacing_mm = search, settings, spacing_mm
        self._to_tips = lumen.to_calyces(places_mm)

    def update(self, features: Features, since: Since | None, sensor: SensorReading | None) -> tuple[Hypotheses, Array]:
        """The hypotheses after a picture, and each one's search score (M,); nothing was known before when None.

        The scores are on the scale of the maps alone, as the test of the kidney knows them, whatever shapes may add.
        """
        scale = self.settings.likelihood_scale
        straight = self.search.everywhere(features)
        prior = self._prior(straight.T_kidney_camera, self._to_tips, since, sensor)
        found = self.search.at_tilts(features, self._worth_trying(prior + straight.score / scale, straight.score))
        found = self.search.with_shapes(features, found)
        T, to_tips = found.T_kidney_camera, self._to_tips[found.views]
        log = self._prior(T, to_tips, since, sensor) + found.score / scale
        weight = np.exp(log - log.max())
        fits = found.score * (self.search.settings.map_weight / found.best_score)
        return Hypotheses(T, to_tips, weight / weight.sum()), fits

    def _worth_trying(self, log: Array, score: Array) -> NDArray[np.int64]:
        """The most probable views, and those that fit best wherever they are."""
        s = self.settings
        probable = np.argsort(-log)[: s.hypotheses - s.best_fitting]
        return np.union1d(probable, np.argsort(-score)[: s.best_fitting])

    def _prior(self, T: Array, to_tips: Array, since: Since | None, sensor: SensorReading | None) -> Array:
        """Log-probability (N,) of poses before the picture is looked at."""
        log = np.zeros(len(T)) if since is None else since.log_probability(T, to_tips)
        if sensor is not None:
            log = log + sensor.log_probability(T, self._spacing_mm)
        return log


def with_incumbent(found: Hypotheses, T: Array, share: float, lumen: LumenDistance) -> Hypotheses:
    """The hypotheses that count, and a track's pose (4, 4) as one more, with that share of the probability."""
    kept = found.weight > _NEGLIGIBLE
    to_tips = np.concatenate([found.to_tips_mm[kept], lumen.to_calyces(T[None, :3, 3])])
    weight = np.append((1 - share) * found.weight[kept], share)
    return Hypotheses(np.concatenate([found.T_kidney_camera[kept], T[None]]), to_tips, weight)


def place(hypotheses: Hypotheses, settings: FilterSettings) -> Array:
    """The weighted mean pose (4, 4) of the hypotheses at the place of the most probable one."""
    weight = hypotheses.weight
    best = int(weight.argmax())
    return mean_pose(hypotheses.T_kidney_camera, weight, best, settings.same_place_mm, settings.same_place_deg)[0]
