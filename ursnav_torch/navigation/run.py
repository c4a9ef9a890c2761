"""Navigating from end to end: a session's events in, states out to a page, rows to the record."""

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ursnav_torch.autonomy import AutonomySettings, Explored
from ursnav_torch.devices import Frame, Gamepad
from ursnav_torch.navigation.autopilot import Autopilot, make_autopilot
from ursnav_torch.navigation.navigator import Navigator
from ursnav_torch.navigation.state import NavigationState
from ursnav_torch.session import Event, Recorder, Replay, Result, Rig, SessionControls, Summary, open_session
from ursnav_torch.simulation import TwinPilot, World
from ursnav_torch.tracking.tracker import TRACKING

#: Shows navigation from beginning to end and steers its session; a web page, for example.
Page = Callable[[Navigator, SessionControls], contextlib.AbstractContextManager[Any]]
#: Bending segments whose lengths differ by less are one.
_SAME_MM = 0.1


@dataclass(slots=True)
class NavigationSummary:
    """What navigating a session brought."""

    session: Summary = field(default_factory=Summary)
    located: int = 0
    passed_over: int = 0
    tracking: int = 0
    latency_ms: tuple[float, float] = (0.0, 0.0)
    last: NavigationState = field(default_factory=NavigationState)
    explored: Explored | None = None

    @property
    def pictures(self) -> int:
        """How many pictures came."""
        return self.session.counts.get(Frame.__name__, 0)

    def text(self) -> str:
        """The summary for people to read."""
        seconds = self.session.seconds
        lines = [
            f"{seconds:.1f} s: {self.pictures} pictures, {self.located} located "
            f"({self.located / max(seconds, 1e-9):.1f} a second), {self.tracking} of them tracking; "
            f"picture to pose {self.latency_ms[0]:.0f} ms median, {self.latency_ms[1]:.0f} ms 95th percentile",
            self.session.text(),
            *(f"  {c.calyx}: {c.verdict}, {c.share:.0%} of its wall seen" for c in self.last.guidance.coverage),
            *([self.explored.text()] if self.explored is not None else []),
        ]
        return "\n".join(lines)


def run_navigation(
    navigator: Navigator,
    hardware: Replay | Callable[..., Rig],
    world: Callable[[], World] | None = None,
    recorder: Recorder | None = None,
    duration_s: float = 0.0,
    page: Page | None = None,
    autonomy: AutonomySettings | None = None,
) -> NavigationSummary:
    """Connect what there is, navigate until the end, disconnect.

    Args:
        navigator: not yet entered.
        hardware, world, recorder, duration_s: see `open_session`.
        page: navigation does not wait for it.
        autonomy: how the scope moves by itself while the dead-man button is held; None does without.

    Raises:
        InputError: the record is to be written over itself, or there is no robot for autonomy to move.
        DeviceError: a device cannot be connected.
    """
    summary = NavigationSummary()

    def count(event: Event) -> None:
        summary.tracking += isinstance(event, Result) and event.row.get("state") == TRACKING

    pilots: list[Autopilot] = []

    def between(hands: Gamepad, rig: Rig, watched: bool) -> Gamepad:
        pilot = make_autopilot(navigator, hands, rig, autonomy or AutonomySettings(), quits=not watched)
        if isinstance(rig.gamepad, TwinPilot):
            rig.gamepad.hands_over = lambda: pilot.is_placed
        pilots.append(pilot)
        return pilot

    steers = None if autonomy is None or isinstance(hardware, Replay) else between
    devices = hardware if isinstance(hardware, Replay) else partial(_built, hardware, navigator)
    opened = open_session(devices, world, recorder, duration_s, page is not None, navigator.forget_place, steers)
    with contextlib.ExitStack() as stack:
        session = stack.enter_context(opened)
        navigator.expect(session.source.pace)
        stack.enter_context(navigator)
        if page:
            stack.enter_context(page(navigator, session.controls))
        summary.session = session.run(navigator, count)
    total = [1e3 * latency.total_s for latency in navigator.latencies]
    if total:
        summary.latency_ms = (float(np.median(total)), float(np.percentile(total, 95)))
    summary.located, summary.passed_over = navigator.located, navigator.passed_over
    summary.last = navigator.bus.latest()
    if pilots:
        summary.explored = pilots[0].explorer.account()
    return summary


def _built(hardware: Callable[..., Rig], navigator: Navigator, **parts: Any) -> Rig:
    """The rig; it is said where its tip bends over another length than tracking takes for the robot's word."""
    rig = hardware(**parts)
    taken_mm = navigator.tracker.settings.odometry.length_mm
    length_mm = taken_mm if rig.robot is None else rig.robot.drive.segment.length_mm
    if abs(length_mm - taken_mm) > _SAME_MM:
        warnings.warn(
            f"The robot's bending segment is {length_mm:g} mm long (hardware.robot.drive.segment.length_mm), but "
            f"tracking moves the tip by one of {taken_mm:g} mm; say tracking.odometry.length_mm={length_mm:g}.",
            stacklevel=2,
        )
    return rig
