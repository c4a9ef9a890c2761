"""One candidate for a stone: its sightings, what they add up to, and the evidence that it is one."""

import numpy as np

from ursnav_torch.geometry import Array
from ursnav_torch.stones.ball import Ball, Clearance, Cones, fit_ball
from ursnav_torch.stones.settings import StoneMapSettings
from ursnav_torch.stones.sighting import StoneSighting

#: Sightings kept of a stone; of more, every other is dropped, so that they go on spanning all visits.
_MOST_KEPT = 48
#: No picture is surer than this.
_SUREST = 0.99
#: And so many in which the picture's edge cuts it.
_MOST_PARTS = 8
#: The place is computed again when the sightings have grown by this factor.
_GROWN = 1.25


#: Where the lens stood, the ray in the kidney frame, the sighting, and the pose's standard deviations.
View = tuple[Array, Array, StoneSighting, float, float]


class _Views:
    """A stone's sightings, not all of many: ``whole`` ones, and ``parts`` that the picture's edge cuts.

    Pictures from one place err alike, and most see too little of a stone: of those within ``alike_mm`` of each other
    the one stays that shows most of it.

    Attributes:
        places_mm: where the lens stood, places within ``alike_mm`` of each other once.
    """

    def __init__(self, alike_mm: float) -> None:
        self._alike_mm = alike_mm
        self.whole: list[View] = []
        self.parts: list[View] = []
        self.places_mm: list[Array] = []
        self._seen, self._stride = 0, 1

    def add(self, view: View) -> None:
        """Keep a sighting, or pass it over where there are many."""
        if len(self.places_mm) < _MOST_KEPT and not any(self._alike(view[0], place) for place in self.places_mm):
            self.places_mm.append(view[0])
        if not view[2].is_whole:
            self.parts = [*self.parts, view][-_MOST_PARTS:]
            return
        for n, kept in enumerate(self.whole):
            if self._alike(view[0], kept[0]):
                self.whole[n] = max(kept, view, key=lambda v: v[2].half_angle)
                return
        if self._seen % self._stride == 0:
            self.whole.append(view)
        self._seen += 1
        if len(self.whole) > _MOST_KEPT:
            self.whole, self._stride = self.whole[::2], 2 * self._stride

    def _alike(self, one: Array, other: Array) -> bool:
        return bool(np.linalg.norm(one - other) < self._alike_mm)

    def telling(self) -> list[View]:
        """Those that tell of place and size: the whole ones where there are any."""
        return self.whole or self.parts


class StoneCandidate:
    """What may be a stone.

    Attributes:
        ball: where it is and how large.
        log_odds: that it is there, from the pictures since it was first seen, kept within bounds.
        best_odds: the most that they ever were.
        pictures: in which it was seen.
        number: that it is told by, from 1; 0 while it is not told.
        apart: in how many pictures each of other candidates was seen beside it, by their `key`.
        best_frame: number of the picture that shows it best.
    """

    def __init__(self, key: int, settings: StoneMapSettings) -> None:
        self.key, self._settings = key, settings
        self.ball = Ball(np.zeros(3), 1.0, np.eye(4))
        self.log_odds, self.best_odds, self.pictures, self.number = 0.0, -np.inf, 0, 0
        self.apart: dict[int, int] = {}
        self.best_frame, self._best = -1, 0.0
        self._views = _Views(settings.alike_mm)
        self._fitted = 0

    def see(self, T: Array, seen: StoneSighting, sd: tuple[float, float], frame: int, weight: float) -> None:
        """Take in a sighting from a pose (4, 4) with standard deviations in mm and radians."""
        self.pictures += 1
        self._views.add((T[:3, 3].copy(), T[:3, :3] @ seen.ray, seen, *sd))
        self.weigh(self._settings.hit * weight * _log_odds(seen.probability))
        shows = seen.extent * seen.probability * (1.0 if seen.is_whole else 0.5)
        if shows > self._best:
            self._best, self.best_frame = shows, frame

    def weigh(self, log_odds: float) -> None:
        """Add to the evidence."""
        self.log_odds = float(np.clip(self.log_odds + log_odds, 2 * self._settings.gone, self._settings.most))
        self.best_odds = max(self.best_odds, self.log_odds)

    @property
    def is_told(self) -> bool:
        """Whether it is a stone by now, or was one beyond doubt before it was gone."""
        s = self._settings
        return self.number > 0 and (self.log_odds >= s.least - s.miss or self.best_odds >= s.certain)

    def settle(self, clearance: Clearance, at_once: bool = False) -> None:
        """Compute place and size again, where there is enough that is new."""
        if at_once or self.pictures >= _GROWN * self._fitted or self.pictures < 4:
            start = self.ball if self._fitted >= 4 else None
            self.ball, self._fitted = fit_ball(self._cones(), clearance, self._settings, start), self.pictures

    def take_over(self, other: "StoneCandidate") -> None:
        """Join another candidate that turned out to be the same."""
        for view in (*other._views.whole, *other._views.parts):
            self._views.add(view)
        self.pictures += other.pictures
        self.number = min((n for n in (self.number, other.number) if n), default=0)
        self.weigh(max(other.log_odds, 0.0))
        self.best_odds = max(self.best_odds, other.best_odds)
        if other._best > self._best:
            self._best, self.best_frame = other._best, other.best_frame
        for key, count in other.apart.items():
            self.apart[key] = self.apart.get(key, 0) + count

    def size_mm(self) -> tuple[float, float]:
        """The longest diameter and its standard deviation, mm."""
        s = self._settings
        whole = self._views.telling()
        distance = np.array([np.linalg.norm(self.ball.center_mm - v[0]) for v in whole])
        extents = 2 * distance * np.sin(np.minimum(np.array([v[2].extent for v in whole]), np.pi) / 2)
        seen = float(np.quantile(extents, s.size_quantile)) * s.size_factor
        independent = max(1.0, len(extents) / s.alike)
        spread = float(np.std(extents)) / np.sqrt(independent) if len(extents) > 1 else 0.3 * seen
        depth = seen * self.ball.position_sd_mm / max(float(np.median(distance)), 1e-3)
        return seen, float(np.sqrt(spread**2 + depth**2 + (0.08 * seen) ** 2))

    def is_stone(self, size_mm: float, sd_mm: float) -> bool:
        """Whether it is large enough for one; where it only may be, by one deviation, two places must show it."""
        may_be = size_mm + sd_mm >= self._settings.smallest_mm and len(self._views.places_mm) > 1
        return size_mm >= self._settings.smallest_mm or may_be

    def _cones(self) -> Cones:
        views = self._views.telling()
        return Cones(
            np.array([v[0] for v in views]), np.array([v[1] for v in views]),
            np.array([v[2].half_angle for v in views]), np.array([v[2].is_whole for v in views]),
            np.array([v[3] for v in views]), np.array([v[4] for v in views]),
        )  # fmt: skip


def _log_odds(probability: float) -> float:
    """Of a probability, kept finite."""
    p = min(probability, _SUREST)
    return float(np.log(p / (1 - p)))
