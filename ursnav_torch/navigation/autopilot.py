"""Autonomy's hands: an input device that adds what an explorer wishes to what the operator's hands allow.

It stands where a gamepad stands, so that everything it asks for passes the same gate, limits and watchdog.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy import ASSIST, AutonomySettings, Explorer, Perception, Permission, Wish
from ursnav_torch.devices import Gamepad, Limits, OperatorInput, Robot
from ursnav_torch.devices.robots.safety import ARMED, STOPPED
from ursnav_torch.errors import InputError
from ursnav_torch.navigation.navigator import Navigator
from ursnav_torch.navigation.state import NavigationState
from ursnav_torch.session import Rig
from ursnav_torch.simulation import SimulatedTime

#: Gray level from which on a pixel shows nothing.
_TOO_BRIGHT = 250
#: A place counts as known once it was for so long, s; set, not varied.
_KNOWN_S = 0.5
#: What an explorer is told, given what the robot reports of itself.
Perceive = Callable[[Robot], Perception]


class Autopilot(Gamepad):
    """Moves the scope as an explorer wishes while the operator holds the dead-man button and touches no stick.

    A stick that is moved takes over at once; with ``assist`` the operator inserts, and autonomy bends.

    Args:
        hands: the operator's.
        robot: what is moved; asked for its gate, its limits and where it stands, never commanded from here.
        explorer: what goes where.
        perceive: what is known now.
        tell: called with the explorer's state and the reason for it, in words, whenever they have changed.
        quits: whether the session ends when there is nothing left to do.
    """

    def __init__(
        self,
        hands: Gamepad,
        robot: Robot,
        explorer: Explorer,
        perceive: Perceive,
        tell: Callable[[str], None] = lambda text: None,
        quits: bool = False,
    ) -> None:
        super().__init__()
        self.hands, self.robot, self.explorer = hands, robot, explorer
        self._perceive, self._tell, self._quits = perceive, tell, quits
        self._told, self._known_from_s, self._now_s = "", np.inf, 0.0

    @property
    def is_placed(self) -> bool:
        """Whether the place has been known for a while, so that the explorer could go on from it."""
        return self._now_s - self._known_from_s >= _KNOWN_S

    def read(self) -> OperatorInput:
        """The operator's input, with autonomy's wish for bend and insertion where that is allowed."""
        self._check_connected()
        own = self.hands.read()
        assists = self.explorer.settings.mode == ASSIST
        taken_over = bool(own.bend_x or own.bend_y or (own.insertion and not assists))
        state = self.robot.gate.state
        may = Permission(own.dead_man and not taken_over, state == ARMED, state == STOPPED or own.emergency_stop)
        seen = self._perceive(self.robot)
        self._now_s = seen.t_s
        is_known = seen.is_known(self.explorer.settings.stale_s, self.explorer.settings.sure_sd_mm)
        self._known_from_s = min(self._known_from_s, seen.t_s) if is_known else np.inf
        wish = self.explorer.step(seen, may)
        text = f"{self.explorer.machine.state.value}: {self.explorer.machine.reason}"
        if text != self._told:
            self._told = text
            self._tell(text)
        if self._quits and self.explorer.finished:
            return replace(own, quit=True)
        if taken_over or wish.is_still:
            return own
        return self._added(own, wish, assists)

    def _added(self, own: OperatorInput, wish: Wish, assists: bool) -> OperatorInput:
        bend_x, bend_y, push = sticks_of(wish, self.robot.limits)
        return replace(own, bend_x=bend_x, bend_y=bend_y, insertion=own.insertion if assists else push)

    def _open(self) -> None:
        self.hands.connect()

    def _close(self) -> None:
        self.hands.disconnect()


def make_autopilot(
    navigator: Navigator, hands: Gamepad, rig: Rig, settings: AutonomySettings, quits: bool
) -> Autopilot:
    """The autopilot of a live session: it is told what the navigator knows, and tells it what it does.

    Raises:
        InputError: there is no robot to move.
    """
    if rig.robot is None:
        raise InputError("Autonomy moves a robot, but there is none: choose hardware/robot=..., or autonomy=none.")
    guide = navigator.guide
    segment = rig.robot.drive.segment
    explorer = Explorer(guide.coverage, navigator.tracker.lumen, settings, guide.limits, segment)
    names = {c.name: i for i, c in enumerate(navigator.vid.kidney.calyces)}
    clock: Callable[[], float] = rig.clock or time.monotonic
    newest: Callable[[], NavigationState] = navigator.bus.latest
    if rig.clock is not None:
        newest = Late(navigator.bus.latest, rig.clock)

    def perceive(robot: Robot) -> Perception:
        state, at = newest(), robot.reported
        frame = state.frame
        return Perception(
            clock(),
            state.T_kidney_camera,
            state.seen_s,
            tuple(names[name] for name in state.calyces if name in names),
            state.position_sd_mm,
            np.array([at.bend_x_rad, at.bend_y_rad]),
            at.insertion_mm,
            state.slack_mm,
            glare_share(frame.image) if frame is not None else 0.0,
            state.guidance.stones.seen,
        )

    def tell(text: str) -> None:
        navigator.say_autonomy(text, explorer.target)

    return Autopilot(hands, rig.robot, explorer, perceive, tell, quits)


def sticks_of(wish: Wish, limits: Limits) -> tuple[float, float, float]:
    """A wish as stick deflections of bend about x and y, and insertion; a bend that is too fast keeps its direction."""
    bend = wish.bend_rad_s / limits.max_bend_rate_rad_s
    bend = bend / max(1.0, float(np.hypot(*bend)))
    push = float(np.clip(wish.insertion_mm_s / limits.max_insertion_rate_mm_s, -1.0, 1.0))
    return float(bend[0]), float(bend[1]), push


class Late:
    """Gives each state as long after its picture was taken as simulated time says that an answer takes.

    Args:
        latest: the newest state.
        clock: the time; call this once in every cycle of control.
    """

    def __init__(self, latest: Callable[[], NavigationState], clock: SimulatedTime) -> None:
        self._latest, self._clock = latest, clock
        self._coming: deque[NavigationState] = deque()
        self._arrived = NavigationState()

    def __call__(self) -> NavigationState:
        """The newest state whose time has come."""
        state = self._latest()
        if not self._coming or self._coming[-1].frame is not state.frame:
            self._coming.append(state)
        while self._coming and self._is_due(self._coming[0]):
            self._arrived = self._coming.popleft()
        return self._arrived

    def _is_due(self, state: NavigationState) -> bool:
        taken_s = state.frame.stamp.t_mono_s if state.frame is not None else 0.0
        return self._clock.now_s >= taken_s + self._clock.answer_s


def glare_share(image: NDArray[np.uint8]) -> float:
    """Share of a picture (H, W) or (H, W, 3) that is too bright to show anything; every fourth pixel is asked."""
    few = image[::4, ::4]
    return float(np.mean((few if few.ndim == 2 else few.min(axis=2)) >= _TOO_BRIGHT))
