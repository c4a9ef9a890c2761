"""Painting what was seen, and finding the way to what was not: the work beside tracking."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import REACH_STRIDE, Coverage
from ursnav_torch.exploration.route import Route, route_to
from ursnav_torch.exploration.settings import ExplorationSettings
from ursnav_torch.exploration.target import next_target
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.navigation.state import Guidance
from ursnav_torch.navigation.status import turn_words
from ursnav_torch.stones import NO_STONES, StoneWatch
from ursnav_torch.tracking.tracker import Tracked
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: Places and sizes of stones need not be computed more often than this, s.
STONES_S = 1.0


class Guide:
    """Keeps the coverage of one exploration and the calyx that is headed for.

    Args:
        vid: the kidney, its lens, and the views that tell what is within reach.
        lumen: distances along its lumen.
        settings: when wall counts as seen, what the scope can do, and how stones are told.
        watch: what is fed with the stones that pictures show.

    Attributes:
        coverage, watch: what was seen of the wall, and which stones.
        chosen: index of the calyx that a person chose, -1 for none.
        headed: index of the calyx that autonomy heads for, -1 for none; a person's choice goes before it.
    """

    def __init__(
        self, vid: Vid, lumen: LumenDistance, watch: StoneWatch, settings: ExplorationSettings | None = None
    ) -> None:
        settings = settings or ExplorationSettings()
        self.kidney, self.limits = vid.kidney, settings.limits
        reach = vid.T_kidney_camera[::REACH_STRIDE]
        self.coverage = Coverage(vid.kidney, vid.camera, lumen, reach, settings.coverage)
        self.watch, self._stones, self._stones_s = watch, NO_STONES, -np.inf
        self.chosen = self.headed = -1
        self._at = vid.kidney.pelvis_mm

    def paint(
        self,
        T_kidney_camera: Array,
        seconds: float,
        bodies: Sequence[ForegroundBody] = (),
        position_sd_mm: float | None = None,
    ) -> None:
        """Count a picture, see `Coverage.add`."""
        self.coverage.add(T_kidney_camera, seconds, bodies, position_sd_mm)

    def see_stones(self, tracked: Tracked, image: NDArray[np.uint8], t_s: float, frame: int) -> None:
        """Take in the stones of a picture (H, W) or (H, W, 3), see `StoneWatch.see`.

        What is told of them follows within `STONES_S`.
        """
        self.watch.see(tracked, image, t_s, frame)
        if not 0 <= t_s - self._stones_s < STONES_S:  # a replay may go back
            self._stones, self._stones_s = self.watch.found(), t_s

    def guidance(self, T_kidney_camera: Array | None) -> Guidance:
        """Coverage and the way on from a pose (4, 4), or from the last one known."""
        if T_kidney_camera is not None:
            self._at = T_kidney_camera[:3, 3]
        chosen = self.chosen  # read once: another thread may choose meanwhile
        target = chosen if chosen >= 0 else self.headed
        if target >= 0:
            route: Route | None = route_to(self.kidney, self._at, target, self.limits)
        else:
            route = next_target(self.coverage, self._at, self.limits)
        here = route or route_to(self.kidney, self._at, 0, self.limits)
        turn = turn_words(T_kidney_camera, route, self.kidney.scale) if route and T_kidney_camera is not None else ""
        name = self.kidney.calyces[chosen].name if chosen >= 0 else ""
        return Guidance(
            here.branches[0], tuple(self.coverage.calyces()), self.coverage.seen(), route, turn, name, self._stones
        )
