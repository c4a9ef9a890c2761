"""The inspection of one calyx: next best views, one after another, until enough was seen or none shows more."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.next_view import ViewPlan, ViewPlanner
from ursnav_torch.autonomy.perception import Perception, Wish
from ursnav_torch.autonomy.settings import AutonomySettings
from ursnav_torch.autonomy.steering import Steering

Array = NDArray[np.float64]

#: Views that are weighed in one cycle of control: each costs a cast of rays.
_VIEWS_A_CYCLE = 2
#: A view is reached within this much bend and insertion, mm at scale 1; held so long; left alone after the longest.
_THERE_RAD, _THERE_MM, _HOLD_S, _LONGEST_VIEW_S = 0.06, 0.3, 0.45, 4.0
#: Wall that so many views were to show and did not is given up; set, not varied.
_VIEWS_IN_VAIN = 2


class Inspection:
    """Takes up views of one calyx after another.

    Args:
        planner: plans them.
        steering: keeps the tip off walls.
        settings: lengths in mm of this kidney.

    Attributes:
        lasted_s: how long the calyx has been inspected; nothing counts between its stretches.
    """

    def __init__(self, planner: ViewPlanner, steering: Steering, settings: AutonomySettings) -> None:
        self._planner, self._steering, self._settings = planner, steering, settings
        self.reset()

    def reset(self) -> None:
        """Another calyx, or this one as if it had never been looked at."""
        self.lasted_s, self._at_s = 0.0, 0.0
        self._in_vain: Counter[int] = Counter()  # views that were to show a patch and did not, by its number
        self._forget()

    def begin(self, seen: Perception) -> None:
        """Begin to inspect from here, or go on with it."""
        self._at_s = seen.t_s
        self._forget()

    def stand_elsewhere(self) -> None:
        """From where the scope goes now, wall that was shown in vain may be seen."""
        self._in_vain.clear()

    def resume(self, seen: Perception) -> None:
        """Go on after a stop; the view that was gone to still is."""
        stood_s, self._at_s = seen.t_s - self._at_s, seen.t_s
        self._view_s += stood_s
        self._held_s += stood_s

    def _forget(self) -> None:
        self._weighed: Iterator[ViewPlan | None] | None = None
        self._best: ViewPlan | None = None
        self._view: ViewPlan | None = None
        self._view_s = self._held_s = 0.0  # since when it is gone to, and held
        self._fine = False  # whether more views are weighed than the usual ones, of which none shows more

    def step(self, seen: Perception, T: Array, calyx: int, missing: float) -> Wish | None:
        """One cycle of control at a pose (4, 4), while so much of a calyx's wall is missing; None: nothing shows more.

        Still while views are weighed; where none of the usual ones shows more, more of them are.
        """
        self.lasted_s, self._at_s = self.lasted_s + seen.t_s - self._at_s, seen.t_s
        if self._view is not None:
            return self._go_to(self._view, seen, T)
        if self._weighed is None:
            least = min(self._settings.least_gain, 0.5 * missing)  # near the end, two small steps are worth it, too
            given_up = np.array([p for p, views in self._in_vain.items() if views >= _VIEWS_IN_VAIN], int)
            self._weighed, self._best = self._planner.candidates(seen, T, calyx, least, given_up, self._fine), None
        for _ in range(_VIEWS_A_CYCLE):
            try:
                self._best = next(self._weighed)
            except StopIteration:
                self._weighed, self._view = None, self._best
                self._view_s = self._held_s = seen.t_s
                return Wish() if self._goes_on() else None
        return Wish()

    def _goes_on(self) -> bool:
        """Whether there is a view, or may still be one among more of them."""
        self._fine = self._view is None and not self._fine
        return self._fine or self._view is not None

    def _go_to(self, plan: ViewPlan, seen: Perception, T: Array) -> Wish:
        """Take up a view and hold it while pictures count."""
        s, steering = self._settings, self._steering
        bend, push = plan.bend_rad - seen.bend_rad, plan.insertion_mm - seen.insertion_mm
        counts = (seen.position_sd_mm or 0.0) <= self._planner.coverage.of_kidney.largest_sd_mm
        if np.hypot(*bend) >= _THERE_RAD or abs(push) >= _THERE_MM * steering.space.scale or not counts:
            self._held_s = seen.t_s
        if seen.t_s - self._held_s > _HOLD_S or seen.t_s - self._view_s > _LONGEST_VIEW_S:
            self._view = None
            self._in_vain.update(plan.patches[~self._planner.coverage.seen()[plan.patches]].tolist())
            return Wish()
        speed = float(np.clip(2.0 * push, -s.advance_mm_s, s.advance_mm_s)) * steering.sureness(seen)
        if push > 0:
            here = float(steering.space.clearance_mm(T[None, :3, 3])[0])
            speed *= steering.freedom(T, min(s.clearance_mm, 0.6 * here))
        return Wish(s.turn_per_s * bend, speed)
