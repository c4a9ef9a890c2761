"""An exploration rehearsed in simulated time: explorer, hands, gate and limits as live, and no clock but its own.

Whether a machine is slow or fast changes nothing: control, pictures and the twin move in steps of one simulated clock,
and a picture's answer arrives after a latency that is told.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy import Explorer, Perception
from ursnav_torch.devices import CommandSample, Gamepad, Note, OperatorInput, Robot, Stamper
from ursnav_torch.devices.robots.safety import ARMED
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.navigation.autopilot import Autopilot
from ursnav_torch.session.control import Control
from ursnav_torch.simulation import SimulatedTime, SteppedRobot, Twin
from ursnav_torch.stones import FoundStone

Array = NDArray[np.float64]

#: Cycles of control a second, as live.
CONTROL_HZ = 50


@dataclass(frozen=True, slots=True, eq=False)
class PictureAnswer:
    """What was made of one picture.

    Attributes:
        T_kidney_camera: (4, 4) the pose, None where it was not believed.
        calyces: indices of the calyces that it may show.
        position_sd_mm: how far off it may be; None where nobody says.
        settled: whether the wall seen may be counted.
        slack_mm: the slider's play as it was learned; None where nobody says.
        stones: those that pictures told of until now.
        bodies: stones and instruments in it, behind which no wall counts.
    """

    T_kidney_camera: Array | None
    calyces: tuple[int, ...] = ()
    position_sd_mm: float | None = None
    settled: bool = True
    slack_mm: float | None = None
    stones: tuple[FoundStone, ...] = ()
    bodies: tuple[ForegroundBody, ...] = ()


#: Makes a sighting of the scope as it is at a time, s.
Locate = Callable[[Twin, float], PictureAnswer]


class SimulatedOperator(Gamepad):
    """Arms at first and holds the dead-man button for as long as ``holds`` says so, by simulated time."""

    def __init__(self, clock: Callable[[], float], holds: Callable[[float], bool] = lambda t_s: True) -> None:
        super().__init__()
        self._stamp, self._clock, self._holds = Stamper(clock), clock, holds
        self._armed = False

    def read(self) -> OperatorInput:
        """The button, and one press of the button that arms."""
        arm, self._armed = not self._armed, True
        return OperatorInput(self._stamp(), arm=arm, dead_man=self._holds(self._clock()))

    def _open(self) -> None: ...

    def _close(self) -> None: ...


@dataclass(slots=True)
class Rehearsed:
    """What a rehearsal brought.

    Attributes:
        t_s, T_kidney_camera, states: at every picture: when, the true pose (4, 4), and the explorer's state.
        places_mm: (3,) of the tip then, but for breathing.
        joints: (3,) true bends and insertion at every picture.
        off_mm: of every sighting with a pose, how far it was off.
        pressed_mm: the largest compression of the shaft since the picture before.
        limited: commands that limits cut.
        stones: those that the newest picture's answer told of.
        disarmed: how often the watchdog or a stop disarmed the robot.
        faults: what went wrong.
    """

    t_s: list[float] = field(default_factory=list)
    T_kidney_camera: list[Array] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    places_mm: list[Array] = field(default_factory=list)
    joints: list[Array] = field(default_factory=list)
    off_mm: list[float] = field(default_factory=list)
    pressed_mm: list[float] = field(default_factory=list)
    stones: tuple[FoundStone, ...] = ()
    limited: int = 0
    disarmed: int = 0
    faults: list[str] = field(default_factory=list)

    @property
    def path_mm(self) -> float:
        """Length of the way that the scope took its tip, steps between pictures added up; breathing is none of it."""
        places = np.array(self.places_mm).reshape(-1, 3)
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def ways_mm(self) -> dict[str, float]:
        """The parts of `path_mm` that it went in each state."""
        steps = np.linalg.norm(np.diff(np.array(self.places_mm).reshape(-1, 3), axis=0), axis=1)
        states = np.array(self.states[1:])
        return {state: float(steps[states == state].sum()) for state in dict.fromkeys(self.states[1:])}


class Rehearsal:
    """Steps through an exploration.

    Args:
        twin: the scope, driven from here.
        explorer: what goes where; its coverage is painted from here.
        locate: makes a sighting of a picture.
        pictures_per_s: rate of the camera.
        operator: whose hand is on the dead-man button; one that never lets go without it.
        clock: the time, which this moves on; by which the twin breathes, too.
    """

    def __init__(
        self,
        twin: Twin,
        explorer: Explorer,
        locate: Locate,
        pictures_per_s: float = 15.0,
        operator: Gamepad | None = None,
        clock: SimulatedTime | None = None,
    ) -> None:
        self.twin, self.explorer, self._locate = twin, explorer, locate
        self._period_s = 1 / pictures_per_s
        self._clock = clock or SimulatedTime()
        self.robot = SteppedRobot(self._clock, twin.scope.drive)
        twin.drive_with(self.robot.axes_mm)
        hands = operator or SimulatedOperator(self._clock)
        self.autopilot = Autopilot(hands, self.robot, explorer, self._perceive)
        self._control = Control(self.robot, self.autopilot)
        self._coming: deque[tuple[float, float, PictureAnswer]] = deque()
        self._newest: tuple[float, PictureAnswer] = (0.0, PictureAnswer(None))
        self._painted_s, self._due_s = 0.0, 0.0

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self._clock.now_s

    def run(self, longest_s: float = 600.0, truth: Coverage | None = None) -> Rehearsed:
        """Explore until there is nothing left to do, or for so long; ``truth`` is painted from the true poses."""
        found = Rehearsed()
        with self.robot, self.autopilot:
            pressed, was_armed = 0.0, False
            while self.now_s < longest_s and not self.explorer.finished:
                self._arrive()
                self._count(found)
                armed = self.robot.gate.state == ARMED
                found.disarmed += was_armed and not armed
                was_armed = armed
                T = self.twin.pose()
                pressed = max(pressed, self.twin.pressed_mm)
                if self.now_s >= self._due_s:
                    self._take(found, T, pressed, truth)
                    pressed = 0.0
                self._clock.now_s += 1 / CONTROL_HZ
        return found

    def _count(self, found: Rehearsed) -> None:
        """One cycle of control, and what it said."""
        for event in self._control.step():
            if isinstance(event, CommandSample):
                found.limited += event.reason == "limit"
            elif isinstance(event, Note):
                found.faults.append(event.text)

    def _take(self, found: Rehearsed, T: Array, pressed: float, truth: Coverage | None) -> None:
        """A picture is taken; its answer is on its way."""
        self._due_s += self._period_s
        sighting = self._locate(self.twin, self.now_s)
        self._coming.append((self.now_s + self._clock.answer_s, self.now_s, sighting))
        if sighting.T_kidney_camera is not None:
            found.off_mm.append(float(np.linalg.norm(sighting.T_kidney_camera[:3, 3] - T[:3, 3])))
        at = self.robot.drive.joints(self.robot.axes_mm())
        found.joints.append(np.array([at.bend_x_rad, at.bend_y_rad, at.insertion_mm]))
        found.t_s.append(self.now_s)
        found.T_kidney_camera.append(T.copy())
        found.places_mm.append(self.twin.undisturbed[:3, 3].copy())
        found.states.append(self.explorer.machine.state.value)
        found.pressed_mm.append(pressed)
        found.stones = sighting.stones
        if truth is not None:
            truth.add(T, self._period_s)

    def _arrive(self) -> None:
        """Answers whose time has come: the newest counts, and all paint the wall."""
        while self._coming and self._coming[0][0] <= self.now_s:
            _, taken_s, sighting = self._coming.popleft()
            self._newest = (taken_s, sighting)  # without a place, too: then it must not go on, as live
            if sighting.T_kidney_camera is not None and sighting.settled:
                sd, stood_s = sighting.position_sd_mm, taken_s - self._painted_s
                self.explorer.coverage.add(sighting.T_kidney_camera, stood_s, sighting.bodies, sd)
            self._painted_s = taken_s

    def _perceive(self, robot: Robot) -> Perception:
        taken_s, sighting = self._newest
        at = robot.reported
        return Perception(
            self.now_s,
            sighting.T_kidney_camera,
            taken_s,
            sighting.calyces,
            sighting.position_sd_mm,
            np.array([at.bend_x_rad, at.bend_y_rad]),
            at.insertion_mm,
            sighting.slack_mm,
            stones=sighting.stones,
        )
