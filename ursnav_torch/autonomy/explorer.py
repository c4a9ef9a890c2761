"""An exploration that goes by itself: from what is known to what the joints shall do, state by state.

Pure logic: no device, no thread and no clock of its own; `Explorer.step` is called in every cycle of control.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.free_space import FreeSpace
from ursnav_torch.autonomy.inspection import Inspection
from ursnav_torch.autonomy.neck import Bar, StoneInTheWay, find_neck, find_stone
from ursnav_torch.autonomy.next_view import ViewPlanner
from ursnav_torch.autonomy.perception import Perception, Permission, Wish
from ursnav_torch.autonomy.resistance import Push
from ursnav_torch.autonomy.settings import AutonomySettings
from ursnav_torch.autonomy.states import MOVING, State, StateMachine
from ursnav_torch.autonomy.steering import Steering, Way
from ursnav_torch.autonomy.tour import Tour
from ursnav_torch.autonomy.visits import OPEN, Explored, Visit
from ursnav_torch.autonomy.way_back import WayBack, joints
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.kinematics import Segment
from ursnav_torch.scaling import scaled
from ursnav_torch.stones import FoundStone

Array = NDArray[np.float64]

#: The shaft is all the way back from here on, mm at scale 1.
_OUT_MM = 0.2
#: A round of looking about takes so long.
_SWEEP_S = 6.0
#: An inspection that a doubt broke off goes on where the tip is within so far of where it was, mm at scale 1.
_SAME_PLACE_MM = 2.0
#: Past a stone that bars a way by more than this the scope cannot be, mm at scale 1: its place is wrong. Both set, not
#: varied.
_PAST_MM = 2.0
#: An inspection that has drawn back so far from where the way in ends, and shows no more, goes in once more; mm at
#: scale 1, set, not varied.
_DRAWN_BACK_MM = 2.0
#: A way in that got farther than those before by this much has not failed, mm at scale 1.
_DEEPER_MM = 1.0


class Explorer:
    """Visits every calyx of a kidney that can be reached, and keeps an account of it.

    Args:
        coverage: what was seen so far; painted by somebody else. Its kidney is the one explored, and from now on no
            picture counts from past a stone in the way.
        lumen: distances and walls.
        settings, limits: how carefully, and what the scope can do; mm at scale 1.
        segment: the scope's bending tip.

    Attributes:
        machine: the state and why.
        visits: what became of each calyx.
        target: index of the calyx that is headed for; -1 for none.
    """

    def __init__(
        self,
        coverage: Coverage,
        lumen: LumenDistance,
        settings: AutonomySettings | None = None,
        limits: ScopeLimits | None = None,
        segment: Segment | None = None,
    ) -> None:
        self.kidney, self.coverage = coverage.kidney, coverage
        self._unit = self.kidney.scale
        self.settings = s = scaled(settings or AutonomySettings(), self._unit)
        self._limits = limits or ScopeLimits()
        segment = segment or Segment()
        self._space = FreeSpace(lumen)
        self._steering = Steering(self._space, segment, s)
        most_bent = np.radians(self._limits.largest_bend_deg)
        planner = ViewPlanner(coverage, self._space, segment, s.clearance_mm, most_bent, s.view_time_mm)
        self._inspection, self._push = Inspection(planner, self._steering, s), Push(s, self._unit)
        self.machine, self.target = StateMachine(), -1
        self.visits = [Visit(c.name) for c in self.kidney.calyces]
        self._ways = [Way(self.kidney, c) for c in range(len(self.visits))]
        self._find_bars(())
        coverage.rules_out = self.is_past_a_stone
        self._way: Way | None = None  # along which the scope came; None where somebody else led it in
        self._way_back, self._lost_at = WayBack(segment, self._unit), np.zeros(3)
        self._room_mm = s.room_mm
        self._doubts = self._hits = self._losses = 0
        self._left: set[int] = set()  # calyces that it comes back to
        self._inspected_from: Array | None = None  # where a doubt broke an inspection off
        self._blocked, self._deepest_mm, self._backed_from = "", 0.0, 0.0
        self._deepened = False  # whether the inspection has gone in once more

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.machine.state is State.FINISHED

    def leave_out(self, calyx: int, reason: str) -> None:
        """A calyx (index) cannot be visited, for a reason that others know: a stone blocks the way."""
        if self.visits[calyx].verdict == OPEN:
            self._share(calyx)
            self.visits[calyx].close(self._least, "", blocked=reason)
            if calyx == self.target:
                self.target = -1

    def account(self) -> Explored:
        """What became of every calyx until now; those still open are closed with what it was doing."""
        machine = self.machine
        visits = tuple(replace(visit) for visit in self.visits)
        if not self.finished:
            self._end(visits, f"ended while {machine.state.value}: {machine.reason}")
        return Explored(visits, machine.reason, self.finished)

    def step(self, seen: Perception, may: Permission) -> Wish:
        """One cycle of control: what the joints shall do now. Still in every state that is not one of `MOVING`."""
        self._push.cycle(seen)
        if seen.stones != self._space.stones:
            self._find_bars(seen.stones)
        if seen.is_known(self.settings.stale_s, self.settings.doubtful_sd_mm):
            self._way_back.add(joints(seen.bend_rad, seen.insertion_mm))
        self._permit(seen, may)
        state = self.machine.state
        if state in (State.WAITING, State.STOPPED, State.FINISHED):
            return Wish()
        doubt = self._doubt(seen)
        if state in MOVING and self.target < 0 and state is not State.WITHDRAWING:
            doubt = doubt or "the calyx that it was on its way to is left out"
        if doubt and state not in (State.LOOKING, State.WITHDRAWING):
            if state is not State.INSPECTING:
                self._inspected_from = None
            self._to(State.LOOKING, seen, doubt)
        wish = self._act(seen, doubt)
        return wish if self.machine.state in MOVING else Wish()

    def _find_bars(self, stones: tuple[FoundStone, ...]) -> None:
        """Find what bars the ways, necks and stones, and where the tour ends before it."""
        self._space.stones, limits = stones, scaled(self._limits, self._unit)
        bars: list[Bar | None] = []
        for way in self._ways:
            met = (find_neck(way, limits, self._unit), find_stone(way, stones, limits, self._unit))
            bars.append(min((bar for bar in met if bar), key=lambda bar: bar.end_mm, default=None))
        self._bars = bars  # whole: who paints asks for them from another thread
        ends = [np.inf if bar is None else bar.end_mm for bar in bars]
        self._tour = Tour(self.kidney, self.settings.standoff_mm, ends)

    def is_past_a_stone(self, T_kidney_camera: Array) -> bool:
        """Whether a pose (4, 4) lies where the scope cannot be: past a stone that it does not get past."""
        place = T_kidney_camera[:3, 3]
        way = min(self._ways, key=lambda way: way.away_mm(place))
        bar = self._bars[way.calyx]
        return isinstance(bar, StoneInTheWay) and way.place_mm(place) > bar.end_mm + _PAST_MM * self._unit

    def _to(self, state: State, seen: Perception, reason: str) -> None:
        self.machine.to(state, seen.t_s, reason)

    def _permit(self, seen: Perception, may: Permission) -> None:
        """An end of permission ends all motion; with it again, it looks first."""
        state = self.machine.state
        if state is State.FINISHED:
            return
        if may.stopped:
            self._to(State.STOPPED, seen, "the robot is stopped")
        elif state is State.STOPPED or not (may.held and may.armed):
            self._to(State.WAITING, seen, "the dead-man button is not held" if may.armed else "the robot is not armed")
        elif state is State.WAITING:
            self._way = None
            self._to(State.LOOKING, seen, "begins")

    def _doubt(self, seen: Perception) -> str:
        """Why it must not go on; empty where the place is known."""
        s = self.settings
        if seen.T_kidney_camera is None or seen.t_s - seen.seen_s > s.stale_s:
            return "no place from the pictures"
        if seen.position_sd_mm is not None and seen.position_sd_mm > s.doubtful_sd_mm:
            return f"the place may be {seen.position_sd_mm:.1f} mm off"
        many = len(seen.calyces) > 1 and self.target in seen.calyces
        sure = seen.position_sd_mm is not None and seen.is_known(s.stale_s, s.sure_sd_mm)
        if many and not sure:  # where it is sure, two are in sight
            return "it may be calyx " + " or ".join(self.visits[c].calyx for c in seen.calyces)
        return ""

    def _act(self, seen: Perception, doubt: str) -> Wish:
        state, T = self.machine.state, seen.T_kidney_camera
        if state is State.LOOKING:
            return self._look(seen, doubt)
        if state is State.WITHDRAWING:
            return self._withdraw(seen, doubt)
        assert T is not None  # else there would be doubt
        if seen.glare > self.settings.glare and state in (State.APPROACHING, State.INSPECTING):
            self._back_off(seen, "the picture is too bright: the wall is near")
        acts = {
            State.RETREATING: self._retreat,
            State.APPROACHING: self._approach,
            State.INSPECTING: self._inspect,
            State.BACKING_OFF: self._go_back,
        }
        return acts[self.machine.state](seen, T)

    def _look(self, seen: Perception, doubt: str) -> Wish:
        """Stand still until the place is known; then go on, or after a while withdraw."""
        s = self.settings
        if not doubt and seen.seen_s > self.machine.since_s:  # by a picture of where it stands now
            self._doubts = 0
            if self.target >= 0 and self._losses >= s.attempts:
                self._leave_for_later(seen, f"the place was lost {self._losses} times on the way there")
            else:
                self._go_on(seen)
        elif seen.t_s - self.machine.since_s > s.look_s:
            self._doubts, self._losses = self._doubts + 1, self._losses + 1
            if self._doubts > s.withdrawals:
                self._finish(seen, f"gave up: {doubt or self.machine.reason}")
            else:
                self._lost_at, self._inspected_from = joints(seen.bend_rad, seen.insertion_mm), None
                self._to(State.WITHDRAWING, seen, doubt)
        else:
            self.machine.reason = doubt or self.machine.reason
        return Wish()

    def _withdraw(self, seen: Perception, doubt: str) -> Wish:
        """Back where the place was known, the way it came; who is all the way back looks about."""
        since_s, here = seen.t_s - self.machine.since_s, joints(seen.bend_rad, seen.insertion_mm)
        to = self._way_back.next(here)
        is_out = to is None and self._is_out(seen)
        gone_mm = self._way_back.apart_mm(self._lost_at, here)
        if not doubt or (since_s > _SWEEP_S if is_out else gone_mm >= self.settings.withdraw_mm):
            self._to(State.LOOKING, seen, doubt or "the place is known again")
            return Wish()
        if is_out:
            return self._steering.sweep(seen, 2 * np.pi * since_s / _SWEEP_S)
        return self._steering.withdraw(seen, np.zeros(3) if to is None else to)

    def _go_on(self, seen: Perception) -> None:
        """Choose what is next, and begin to go there; where the target stays, so does what was tried."""
        if self.target < 0:
            self._choose(seen)
        elif self._stands_where_it_inspected(seen):
            self._inspection.resume(seen)
            self._to(State.INSPECTING, seen, f"looks on at the wall of calyx {self.visits[self.target].calyx}")
            return
        if not self.finished:
            self._to(State.RETREATING, seen, f"to calyx {self.visits[self.target].calyx}")

    def _stands_where_it_inspected(self, seen: Perception) -> bool:
        """Whether a doubt broke an inspection off here."""
        from_mm, T = self._inspected_from, seen.T_kidney_camera
        if from_mm is None or T is None:
            return False
        return float(np.linalg.norm(T[:3, 3] - from_mm)) <= _SAME_PLACE_MM * self._unit

    def _choose(self, seen: Perception) -> None:
        """The next calyx of the shortest tour through all that are open; those tried before come last."""
        assert seen.T_kidney_camera is not None
        place = seen.T_kidney_camera[:3, 3]
        self._leave_out_hidden()
        left = [c for c, visit in enumerate(self.visits) if visit.verdict == OPEN]
        late = [c for c in left if self.visits[c].attempts]
        order = self._tour.order(place, left, late)
        if not order:
            self._finish(seen, "every calyx was visited")
            return
        self.target, self._hits, self._losses, self._room_mm = order[0], 0, 0, self.settings.room_mm
        self._inspection.reset()
        self._inspected_from = None
        self._blocked, self._deepest_mm, self._deepened = "", 0.0, False

    def _leave_out_hidden(self) -> None:
        """Leave out the calyces behind stones, from before which next to nothing of them is seen.

        Those behind necks are looked into, however little of their wall shows: a stone may lie there.
        """
        for calyx, (visit, bar) in enumerate(zip(self.visits, self._bars, strict=True)):
            if not isinstance(bar, StoneInTheWay) or visit.verdict != OPEN:
                continue
            if self._shown(calyx, bar) < self._least[0]:
                self.leave_out(calyx, bar.reason(visit.calyx))

    def _shown(self, calyx: int, bar: Bar) -> float:
        """Part of a calyx's wall, of what the scope can see of it, that shows from before what bars the way."""
        return self.coverage.share(calyx, self.coverage.in_view(bar.T_kidney_camera))

    def _retreat(self, seen: Perception, T: Array) -> Wish:
        """Back along the way that the scope came, until it can turn into the way to the target."""
        to = self._ways[self.target]
        way = self._way = self._way or self._way_at(T[:3, 3], to)
        at, shared = way.place_mm(T[:3, 3]), to.shared_mm(way)
        is_back = at <= max(shared - self._room_mm * (way is not to), 0.0) or self._is_out(seen)
        if is_back or (way is not to and self._steering.can_turn_into(seen, T, to)):
            self._way = to
            self._begin(seen, T)
            return Wish()
        return self._steering.retreat(seen, T, way, self._way_back.before(joints(seen.bend_rad, seen.insertion_mm)))

    def _way_at(self, place_mm: Array, to: Way) -> Way:
        """The way that a place (3,) lies on: ``to`` where more than one leads there."""
        return min(self._ways, key=lambda way: (way.away_mm(place_mm), way is not to))

    def _is_out(self, seen: Perception) -> bool:
        """Whether the shaft is all the way back."""
        return seen.insertion_mm <= _OUT_MM * self._unit

    def _begin(self, seen: Perception, T: Array) -> None:
        """Begin a way in."""
        self._push.begin(seen, T[:3, 3], self._ways[self.target].place_mm(T[:3, 3]))
        self._to(State.APPROACHING, seen, f"into calyx {self.visits[self.target].calyx}")

    def _approach(self, seen: Perception, T: Array) -> Wish:
        """Along the way in, until its end or something else is reached."""
        s, way, visit = self.settings, self._ways[self.target], self.visits[self.target]
        self._push.see(seen, T[:3, 3])
        at = way.place_mm(self._push.place_mm)
        visit.nearest_mm = min(visit.nearest_mm, way.length_mm - at)
        if way.length_mm - at <= s.standoff_mm or self._share(self.target) >= s.done_share:
            self._look_around(seen)
            return Wish()
        bar = self._bars[self.target]
        if bar is not None and at >= bar.end_mm:
            self._blocked = bar.reason(visit.calyx)
            self._look_around(seen)
            return Wish()
        gets_on = self._push.gets_on(at, seen.t_s)
        where = f"{way.length_mm - at:.0f} mm before the tip of calyx {visit.calyx}"
        if self._push.resists(T[:3, 2]):
            self._back_off(seen, f"meets resistance {where}")
            return Wish()
        if not gets_on:
            self._back_off(seen, f"does not get on {where}")
            return Wish()
        return self._steering.advance(seen, T, way)

    def _look_around(self, seen: Perception) -> None:
        """Begin to inspect from here, or go on with it."""
        assert seen.T_kidney_camera is not None
        self._inspection.begin(seen)
        self._inspected_from = seen.T_kidney_camera[:3, 3]
        self._to(State.INSPECTING, seen, f"looks at the wall of calyx {self.visits[self.target].calyx}")

    def _back_off(self, seen: Perception, reason: str) -> None:
        self._backed_from = seen.insertion_mm
        deeper = self._push.best_mm > self._deepest_mm + _DEEPER_MM * self._unit
        self._deepest_mm = max(self._deepest_mm, self._push.best_mm)
        self._hits = 1 if deeper else self._hits + 1
        self._to(State.BACKING_OFF, seen, reason)

    def _go_back(self, seen: Perception, T: Array) -> Wish:
        """A little back, farther each time; then the way in again, or another calyx."""
        s, visit = self.settings, self.visits[self.target]
        if self._backed_from - seen.insertion_mm < s.back_off_mm * self._hits and not self._is_out(seen):
            return self._steering.retreat(seen, T, self._ways[self.target])
        visit.attempts += 1
        if self._hits >= s.attempts:
            self._blocked = self.machine.reason
            self._look_around(seen)
        else:
            self._begin(seen, T)
        return Wish()

    def _inspect(self, seen: Perception, T: Array) -> Wish:
        """Turn to the wall that was not seen, until enough was, or no view shows more."""
        s, share, self._inspected_from = self.settings, self._share(self.target), T[:3, 3]
        if share >= s.done_share:
            self._close(seen, "")
            return Wish()
        if self._inspection.lasted_s > s.inspect_s:
            self._close(seen, "the rest was not seen in time")
            return Wish()
        wish = self._inspection.step(seen, T, self.target, s.done_share - share)
        if wish is None and self._may_go_deeper(T):
            self._inspection.stand_elsewhere()
            self._begin(seen, T)
        elif wish is None:
            self._close(seen, "no view from here shows more of it")
        return wish or Wish()

    def _may_go_deeper(self, T: Array) -> bool:
        """Whether the views of an inspection have drawn a pose (4, 4) back from where the way in may end, once."""
        way, bar = self._ways[self.target], self._bars[self.target]
        end_mm = min(way.length_mm - self.settings.standoff_mm, np.inf if bar is None else bar.end_mm)
        if self._blocked or self._deepened or way.place_mm(T[:3, 3]) > end_mm - _DRAWN_BACK_MM * self._unit:
            return False
        self._deepened = True
        return True

    def _share(self, calyx: int) -> float:
        """Part of a calyx's wall that was seen, of what the scope can see of it."""
        share = self.visits[calyx].share = self.coverage.share(calyx, self.coverage.seen())
        return share

    def _close(self, seen: Perception, reason: str) -> None:
        """Be done with the target, for good or bad, and go on to the next."""
        self._share(self.target)
        self.visits[self.target].close(self._least, reason, self._blocked)
        self.target = -1
        self._choose(seen)
        if not self.finished:
            self._to(State.RETREATING, seen, f"to calyx {self.visits[self.target].calyx}")

    def _leave_for_later(self, seen: Perception, reason: str) -> None:
        """Come back to the target after all others, where it was not left before; else be done with it."""
        if self.target in self._left:
            self._close(seen, reason)
            return
        self._left.add(self.target)
        self.visits[self.target].attempts += 1
        self.target = -1
        self._go_on(seen)

    def _finish(self, seen: Perception, reason: str) -> None:
        self._end(self.visits, reason)
        self.target = -1
        self._to(State.FINISHED, seen, reason)

    @property
    def _least(self) -> tuple[float, float]:
        """Shares of a calyx's wall from which on it is partly seen and inspected."""
        return self.coverage.settings.glimpsed, self.settings.done_share

    def _end(self, visits: Sequence[Visit], reason: str) -> None:
        """Close what is open, for a reason; what was seen in passing counts for all."""
        for calyx, (visit, seen) in enumerate(zip(visits, self.coverage.calyces(), strict=True)):
            visit.share = max(visit.share, seen.share)
            if visit.verdict == OPEN:
                visit.close(self._least, reason, self._blocked if calyx == self.target else "")
            elif visit.share >= self.settings.done_share:
                visit.close(self._least, "")
