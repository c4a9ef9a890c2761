"""The next best view: of the poses that the scope can take from here, the one that shows most wall not yet seen.

Greedy next-best-view planning (Connolly, ICRA 1985) over bends and small advances that kinematics and walls allow.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.free_space import FreeSpace
from ursnav_torch.autonomy.perception import Perception
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.geometry import inverse
from ursnav_torch.kinematics import Segment

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Bends away from the present one that are tried, in these directions, and advances along the curve, mm at scale 1.
_BENDS_RAD, _DIRECTIONS = np.radians([20.0, 45.0, 70.0]), 6
_ADVANCES_MM = (0.0, -2.5, 1.5, -5.0)
#: And the bends of the tip, in so many directions, and advances that are tried where none of these shows more.
_FINE_BENDS_RAD, _FINE_DIRECTIONS = np.radians(np.arange(15.0, 106.0, 15.0)), 8
_FINE_ADVANCES_MM = (0.0, -1.5, -4.0, -7.0, 1.0, 2.5)
#: Views are planned for pictures whose place is off by no more than this, mm at scale 1, as they may be once it stands;
#: set, not varied, as the views.
_SHARP_MM = 0.35
#: Where a bend is cut off by a wall is looked for in so many steps.
_SHARES = np.linspace(0.0, 1.0, 17)


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlan:
    """A view to go to.

    Attributes:
        bend_rad: (2,) the robot's bend there.
        insertion_mm: its insertion there.
        gain: part of the calyx's wall, of what the scope can see of it, that this view adds.
        worth: gain for the way that the tip makes to get there, 1/mm.
        patches: (N,) those of the calyx that it shows and that were not seen, by their numbers.
    """

    bend_rad: Array
    insertion_mm: float
    gain: float
    worth: float
    patches: IntArray


@dataclass(frozen=True, slots=True)
class ViewPlanner:
    """Plans views in one kidney.

    Attributes:
        coverage: what was seen so far.
        space: what is free of walls and stones.
        segment: the scope's bending tip.
        kept_mm: how near the tip may come to the wall, mm of this kidney.
        largest_bend_rad: of the tip.
        time_mm: a view costs the tip's way to it, and so much of way for the time that it takes, mm of this kidney.
    """

    coverage: Coverage
    space: FreeSpace
    segment: Segment
    kept_mm: float
    largest_bend_rad: float
    time_mm: float

    def candidates(
        self,
        seen: Perception,
        T: Array,
        calyx: int,
        least_gain: float,
        given_up: IntArray | None = None,
        fine: bool = False,
    ) -> Iterator[ViewPlan | None]:
        """Views from a pose (4, 4) one by one, as each costs a cast of rays.

        Args:
            seen: where the joints are, and how far off the place may be.
            T: the pose.
            calyx: index of the one that is inspected.
            least_gain: what adds less is no view to go to.
            given_up: (M,) numbers of patches that count for nothing.
            fine: try more views than the usual ones.

        Returns:
            The best view until now by gain for its way; None while there is none.
        """
        own = (self.coverage.patches.calyx == calyx) & self.coverage.in_reach
        area = self.coverage.patches.area_mm2
        unseen = own & ~self.coverage.seen()
        area = area / max(float(area[own].sum()), 1e-9)
        if given_up is not None:
            unseen[given_up] = False
        off_mm = min(seen.position_sd_mm or 0.0, _SHARP_MM * self.space.scale)
        best: ViewPlan | None = None
        for advance in (self.space.scale * mm for mm in (_FINE_ADVANCES_MM if fine else _ADVANCES_MM)):
            if seen.insertion_mm + advance < 0:
                continue
            for bend in self._bends(seen.bend_rad, fine):
                found = self._pose(T, seen.bend_rad, bend, advance)
                if found is not None:
                    cost = self.time_mm + float(np.linalg.norm(found[:3, 3] - T[:3, 3]))
                    least = max(least_gain, 0.0 if best is None else best.worth * cost)
                    shown = self.coverage.in_view(found, unseen)
                    if off_mm > 0 and area[shown].sum() > least:  # what is surely in view, where it may matter
                        shown = self.coverage.surely_in_view(found, off_mm, unseen)
                    gain = float(area[shown].sum())
                    if gain > least:
                        best = ViewPlan(bend, seen.insertion_mm + advance, gain, gain / cost, shown)
                    yield best

    def _bends(self, now: Array, fine: bool) -> list[Array]:
        if fine:
            bends = [np.zeros(2), *_around(_FINE_BENDS_RAD, _FINE_DIRECTIONS)]
        else:
            bends = [np.asarray(now, float), *(now + away for away in _around(_BENDS_RAD, _DIRECTIONS))]
        return [b for b in bends if np.hypot(*b) <= self.largest_bend_rad]

    def _pose(self, T: Array, bend_now: Array, bend: Array, advance_mm: float) -> Array | None:
        """The pose (4, 4) after a change of bend and an advance; None where a wall is in the way of advancing.

        A bend that meets a wall turns the tip and takes it as far as the wall lets it.
        """
        straight = inverse(self.segment.point_transform(bend_now))
        base = T @ straight @ self.segment.point_transform(bend_now, self.segment.length_mm + advance_mm)
        ahead = T[:3, 3] + _SHARES[:, None] * (base[:3, 3] - T[:3, 3])
        if advance_mm > 0 and self.space.clearance_mm(ahead).min() < self.kept_mm:
            return None
        found = base @ straight @ self.segment.point_transform(bend)
        swing = base[:3, 3] + _SHARES[:, None] * (found[:3, 3] - base[:3, 3])
        free = self.space.clearance_mm(swing) >= self.kept_mm
        found[:3, 3] = swing[max(int(free.argmin()) - 1, 0) if not free.all() else -1]
        return found


def _around(radii: Array, directions: int) -> list[Array]:
    """Bends (2,) of some sizes in so many directions, radians."""
    turns = np.arange(directions) * 2 * np.pi / directions
    return [r * np.array([np.cos(t), np.sin(t)]) for r in radii for t in turns]
