"""Navigating from end to end: devices or a record in, states out to observers, rows to the record."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ursnav_torch.devices import Frame, Output
from ursnav_torch.errors import InputError
from ursnav_torch.navigation.console import Console
from ursnav_torch.navigation.navigator import Navigator
from ursnav_torch.navigation.player import Player
from ursnav_torch.navigation.state import NavigationState
from ursnav_torch.session import Event, Live, Recorder, Replay, Result, Rig
from ursnav_torch.session.hold import share
from ursnav_torch.simulation import World


@dataclass(frozen=True, slots=True)
class Desk:
    """All that an observer may look at and touch.

    Attributes:
        navigator: state, coverage, and the choice of where to go.
        console: the hands of a robot's operator; None in a replay.
        player: what a replay is steered by; None live.
        stop: ends the session.
    """

    navigator: Navigator
    console: Console | None
    player: Player | None
    stop: Callable[[], None]


#: Watches a session from beginning to end; a web page, for example.
Observer = Callable[[Desk], contextlib.AbstractContextManager[Any]]


@dataclass(slots=True)
class NavigationSummary:
    """What a session brought."""

    pictures: int = 0
    located: int = 0
    passed_over: int = 0
    tracking: int = 0
    seconds: float = 0.0
    dropped: int = 0
    latency_ms: tuple[float, float] = (0.0, 0.0)
    last: NavigationState = field(default_factory=NavigationState)

    def text(self) -> str:
        """The summary for people to read."""
        lines = [
            f"{self.seconds:.1f} s: {self.pictures} pictures, {self.located} located "
            f"({self.located / max(self.seconds, 1e-9):.1f} a second), {self.tracking} of them tracking; "
            f"picture to pose {self.latency_ms[0]:.0f} ms median, {self.latency_ms[1]:.0f} ms 95th percentile",
            *(f"  {c.calyx}: {c.verdict}, {c.share:.0%} of its wall seen" for c in self.last.guidance.coverage),
        ]
        return "\n".join(lines)


def hold_navigation(
    navigator: Navigator,
    hardware: Replay | Callable[..., Rig],
    world: Callable[[], World] | None = None,
    recorder: Recorder | None = None,
    duration_s: float = 0.0,
    observer: Observer | None = None,
) -> NavigationSummary:
    """Connect what there is, navigate until the end, disconnect.

    Args:
        navigator: not yet entered.
        hardware: a record, or what builds a rig when given ``world`` (a partial of `build_rig`).
        world: makes the anatomy of a simulated scope; called only when there is one.
        recorder: where everything goes, or None.
        duration_s: end after so long; 0 for no end but the operator's, or the record's.
        observer: a page; navigation does not wait for it.

    Raises:
        InputError: the record is to be written over itself.
        DeviceError: a device cannot be connected.
    """
    with contextlib.ExitStack() as stack:
        output: Output | None = None
        if isinstance(hardware, Replay):
            if recorder and recorder.path.absolute() == hardware.path.absolute():
                raise InputError(
                    f"{hardware.path} cannot be replayed and written at the same time; choose another out=."
                )
            player = Player(hardware, observer is not None, navigator.forget_place)
            source: Live | Player = player
            live = navigator.expects_pictures = False
            desk = Desk(navigator, None, player, player.stop)
        else:
            rig = hardware(world=world)
            console = Console(rig.gamepad, rig.robot, rig.twin is not None, observer is not None)
            rig = stack.enter_context(replace(rig, gamepad=console))
            source, output, live = Live(rig, duration_s), rig.output, rig.twin is None
            desk = Desk(navigator, console, None, source.stop)
        if recorder:
            stack.enter_context(recorder)
        stack.enter_context(navigator)
        if observer:
            stack.enter_context(observer(desk))
        return _run(navigator, source, _keep(recorder, output), duration_s, live)


def _run(
    navigator: Navigator, source: Live | Player, keep: Callable[[Event], None], duration_s: float, live: bool
) -> NavigationSummary:
    """Work through a session."""
    summary = NavigationSummary()
    first_s: float | None = None
    begun = time.monotonic()
    exhaustive = isinstance(source, Player) and source.replay.speed == 0
    try:
        for event in source:
            if isinstance(event, Result):
                continue  # of the session that is replayed; made anew
            t_s = event.stamp.t_mono_s
            first_s = t_s if first_s is None else first_s
            keep(event)
            navigator.take(event, live)
            if isinstance(event, Frame):
                summary.pictures += 1
                if exhaustive:
                    navigator.wait()
            _collect(navigator, keep, summary)
            if isinstance(source, Player) and 0 < duration_s <= t_s - first_s:
                source.stop()
    except KeyboardInterrupt:  # the usual end of a session without a page
        source.stop()
    navigator.wait()
    _collect(navigator, keep, summary)
    summary.seconds = time.monotonic() - begun
    total = [1e3 * latency.total_s for latency in navigator.latencies]
    if total:
        summary.latency_ms = (float(np.median(total)), float(np.percentile(total, 95)))
    summary.located, summary.passed_over = navigator.located, navigator.passed_over
    summary.dropped = source.dropped if isinstance(source, Live) else 0
    summary.last = navigator.bus.latest()
    return summary


def _collect(navigator: Navigator, keep: Callable[[Event], None], summary: NavigationSummary) -> None:
    """Keep the rows that were made meanwhile."""
    for result in navigator.results():
        summary.tracking += result.row.get("state") == "tracking"
        keep(result)


def _keep(recorder: Recorder | None, output: Output | None) -> Callable[[Event], None]:
    """What becomes of every event: written, and shown to another program."""
    takers = [recorder.write] if recorder else []
    takers += [partial(share, output)] if output else []

    def keep(event: Event) -> None:
        for take in takers:
            take(event)

    return keep
