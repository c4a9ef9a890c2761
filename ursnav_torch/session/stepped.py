"""A session in simulated time: nothing waits for a clock, and whether a machine is slow or fast changes nothing."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

from ursnav_torch.devices import OperatorInput
from ursnav_torch.errors import InputError
from ursnav_torch.session.control import Control
from ursnav_torch.session.events import Event
from ursnav_torch.session.live import CONTROL_HZ
from ursnav_torch.session.rig import Rig
from ursnav_torch.session.source import LosslessSource, Pace
from ursnav_torch.simulation import SimulatedTime, SteppedCamera, SteppedRobot, Twin, TwinPilot, World


class Stepped(LosslessSource):
    """The events of a simulated rig, cycle by cycle of control, until the operator quits.

    Time goes on when an event was dealt with: every picture is located before the scope moves on.

    Args:
        rig: connected, with a clock, a `SteppedCamera` and whatever drives; see `rehearse`.
        duration_s: end after so much simulated time; 0 for no end.

    Raises:
        InputError: the rig has no clock, or a camera that goes by another.
    """

    def __init__(self, rig: Rig, duration_s: float = 0.0) -> None:
        if rig.clock is None or not isinstance(rig.camera, SteppedCamera) or rig.gamepad is None:
            raise InputError("Simulated time needs a clock, a SteppedCamera and hands; start from hardware=rehearsed.")
        self.rig, self.duration_s = rig, duration_s
        self._clock, self._camera = rig.clock, rig.camera
        self._control = Control(rig.robot, rig.gamepad, rig.light, clock=rig.clock)
        self._end = threading.Event()

    @property
    def pace(self) -> Pace:
        """Time waits until each picture is dealt with."""
        return Pace(stamped_now=False, steady=False, patient=True)

    def stop(self) -> None:
        """End the session."""
        self._end.set()

    def __iter__(self) -> Iterator[Event]:
        """All events in the order of simulated time; the robot is disarmed at the end."""
        try:
            while not self._end.is_set():
                for event in self._control.step():
                    yield event
                    if isinstance(event, OperatorInput) and event.quit:
                        self._end.set()
                if self.rig.twin is not None:
                    self.rig.twin.pose()  # the scope follows its motors step by step
                if self._clock.now_s >= self._camera.due_s:
                    yield self._camera.read()
                self._clock.now_s += 1 / CONTROL_HZ
                if 0 < self.duration_s <= self._clock.now_s:
                    self._end.set()
        finally:
            if self.rig.robot is not None and self.rig.robot.is_connected:
                self.rig.robot.disarm()


def rehearse(
    twin: Callable[[World], Twin],
    rate_hz: float = 15.0,
    answer_s: float = 0.13,
    world: Callable[[], World] | None = None,
) -> Rig:
    """A rig in simulated time: a twin, its camera, a robot that is arithmetic, and a pilot.

    Args:
        twin: makes the digital twin.
        rate_hz: pictures a second of simulated time.
        answer_s: simulated time from a picture to what is made of it.
        world: makes the anatomy for the twin.

    Raises:
        InputError: there is no world, or the rate is not positive.
    """
    if world is None:
        raise InputError("A simulated scope needs a kidney to be in; start from navigate vid=... hardware=rehearsed.")
    clock = SimulatedTime(answer_s=answer_s)
    the_world = replace(world(), clock=clock)
    made = twin(the_world)
    robot = SteppedRobot(clock, made.scope.drive)
    made.drive_with(robot.axes_mm)
    pilot = TwinPilot(made, the_world.kidney, clock=clock)
    return Rig(SteppedCamera(made, clock, rate_hz), robot=robot, gamepad=pilot, twin=made, clock=clock)
