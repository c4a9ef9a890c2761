"""Stones as a track goes on: only poses that are believed count, and the best picture of each stone is kept."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.stones.known import KnownStone, StoneList, compare_stones
from ursnav_torch.stones.map import FoundStone, StoneMap
from ursnav_torch.stones.settings import StoneMapSettings
from ursnav_torch.tracking.tracker import Tracked, Tracker

#: Of a pose that does not say how far off it may be: mm at scale 1, and radians.
_SD_MM, _SD_RAD = 0.5, 0.05


class StoneWatch:
    """Feeds a map of stones with a track's answers.

    Args:
        stones: the map to be fed.
        known: stones of a scan, which those that are seen are compared with.
        tell: called with the stones (S, 4) that are there, x, y, z and radius, after every picture taken in.

    Attributes:
        stones: the map.
        known: see there.
        pictures: by number of a picture that shows some stone best: the picture (H, W) or (H, W, 3), and its bodies.
    """

    def __init__(
        self,
        stones: StoneMap,
        known: tuple[KnownStone, ...] = (),
        tell: Callable[[NDArray[np.float64]], None] = lambda balls_mm: None,
    ) -> None:
        self.stones, self.known, self._tell = stones, known, tell
        self.pictures: dict[int, tuple[NDArray[np.uint8], tuple[ForegroundBody, ...]]] = {}

    def see(self, tracked: Tracked, image: NDArray[np.uint8], t_s: float, frame: int) -> None:
        """Take in the answer to a picture; one without a settled pose is passed over, blurred and foggy ones too."""
        if tracked.T_kidney_camera is None or not tracked.is_settled:
            return
        sd = _SD_MM * self.stones.kidney.scale, _SD_RAD
        if tracked.certainty is not None:
            sd = tracked.certainty.position_sd_mm, float(np.radians(tracked.certainty.direction_sd_deg))
        self.stones.add(tracked.T_kidney_camera, tracked.bodies, t_s, frame, sd)
        self._tell(self.stones.balls_mm())
        wanted = self.stones.best_frames()
        if frame in wanted and image.size:
            self.pictures[frame] = (image.copy(), tracked.bodies)
        for number in self.pictures.keys() - wanted:
            del self.pictures[number]

    def found(self) -> StoneList:
        """All stones that are told by now, beside the known ones, and fragments."""
        return compare_stones(self.stones.told(), self.known, self.stones.kidney.scale)

    def picture_of(self, stone: FoundStone) -> tuple[NDArray[np.uint8], tuple[ForegroundBody, ...]] | None:
        """The picture that shows a stone best, and its bodies; None where none was kept."""
        return self.pictures.get(stone.frame)


def watch_stones(tracker: Tracker, settings: StoneMapSettings, known: tuple[KnownStone, ...] = ()) -> StoneWatch:
    """What is to be fed with a tracker's answers, and tells it what hides the wall; ``known`` are a scan's stones."""
    stones = StoneMap(tracker.vid.kidney, tracker.lumen, tracker.working_camera, settings)
    return StoneWatch(stones, known, tracker.known.tell)
