"""Opening a session: devices or a record connected, recorder and other programs attached, signals heard."""

import contextlib
import json
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import FrameType

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.devices import Frame, Gamepad, Output, RobotSample
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.session.console import Console
from ursnav_torch.session.events import Event, Result
from ursnav_torch.session.live import Live
from ursnav_torch.session.player import Player
from ursnav_torch.session.record import Recorder
from ursnav_torch.session.replay import Replay
from ursnav_torch.session.rig import Rig, World
from ursnav_torch.session.run import Observer, Summary, Worker, run_session
from ursnav_torch.session.source import EventSource
from ursnav_torch.session.stepped import Stepped

#: Puts something between the hands and the robot: given the console, the rig with its own gamepad, and whether a page
#: watches.
Between = Callable[[Console, Rig, bool], Gamepad]

#: Pictures whose moments are remembered for the poses that are told of them later.
_REMEMBERED = 256
#: What ends a session in good order: Ctrl-C, `kill`, a terminal that closes.
SIGNALS = tuple(getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n))


@dataclass(frozen=True, slots=True)
class SessionControls:
    """All that a page may touch of a session.

    Attributes:
        stop: ends the session.
        console: the hands of a robot's operator; None in a replay.
        player: what a replay is steered by; None live.
        by_itself: whether the scope moves by itself while the dead-man button is held.
    """

    stop: Callable[[], None]
    console: Console | None = None
    player: Player | None = None
    by_itself: bool = False


@dataclass(frozen=True, slots=True)
class Session:
    """An open session: where its events come from, what steers it, and who keeps them."""

    source: EventSource
    controls: SessionControls
    keepers: tuple[Observer, ...]

    def run(self, worker: Worker | None = None, *observers: Observer) -> Summary:
        """Work through it until its end; see `run_session`."""
        return run_session(self.source, worker, (*self.keepers, *observers))


@contextlib.contextmanager
def open_session(
    hardware: Replay | Callable[..., Rig],
    world: Callable[[], World] | None = None,
    recorder: Recorder | None = None,
    duration_s: float = 0.0,
    watched: bool = False,
    on_seek: Callable[[], None] = lambda: None,
    between: Between | None = None,
) -> Iterator[Session]:
    """Connect what there is; disconnect at the end. `SIGNALS` end the session in good order, a second one at once.

    Args:
        hardware: a record, or what builds a rig when given ``world`` (a partial of `build_rig` or `rehearse`).
        world: makes the anatomy of a simulated scope; called only when there is one.
        recorder: where everything goes, or None.
        duration_s: end after so long; 0 for no end but the operator's, or the record's.
        watched: a page watches: a replay stays open at its end, a pilot leaves the scope to the page.
        on_seek: called when a replay goes on from another moment.
        between: what adds to the operator's hands, such as autonomy.

    Raises:
        InputError: the record is to be written over itself.
        DeviceError: a device cannot be connected.
    """
    with contextlib.ExitStack() as stack:
        if isinstance(hardware, Replay):
            session = _open_replay(hardware, recorder, Player(hardware, watched, on_seek, duration_s))
        else:
            session = _open_rig(hardware(world=world), duration_s, watched, stack, between)
        stack.enter_context(ended_by_signals(session.source.stop))
        keepers = session.keepers if recorder is None else (stack.enter_context(recorder).write, *session.keepers)
        yield replace(session, keepers=keepers)


def _open_replay(replay: Replay, recorder: Recorder | None, player: Player) -> Session:
    if recorder and recorder.path.absolute() == replay.path.absolute():
        raise InputError(f"{replay.path} cannot be replayed and written at the same time; choose another out=.")
    return Session(player, SessionControls(player.stop, player=player), ())


def _open_rig(
    rig: Rig, duration_s: float, watched: bool, stack: contextlib.ExitStack, between: Between | None
) -> Session:
    clock: Callable[[], float] = rig.clock or time.monotonic
    may_drive = rig.robot is not None and rig.robot.simulated
    console = Console(rig.gamepad, rig.robot, may_drive, stay=watched, clock=clock)
    hands: Gamepad = console
    if between is not None:
        hands = between(console, rig, watched)
    rig = stack.enter_context(replace(rig, gamepad=hands))
    live: EventSource = Live(rig, duration_s) if rig.clock is None else Stepped(rig, duration_s)
    keepers = (Publisher(rig.output),) if rig.output else ()
    return Session(live, SessionControls(live.stop, console, by_itself=between is not None), keepers)


@contextlib.contextmanager
def ended_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Inside, the first of `SIGNALS` calls ``stop``, which must not wait; the next acts as it did before.

    Signals reach the main thread only; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def end(_number: int, _frame: FrameType | None) -> None:
        restore()
        stop()

    for number in SIGNALS:
        signal.signal(number, end)
    try:
        yield
    finally:
        restore()


class Publisher:
    """Shows events to another program: pictures, joints, the pose of a row that was accepted, coverage.

    A pose has the time of its picture, from which it was told later.
    """

    def __init__(self, output: Output) -> None:
        self._output = output
        self._taken: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)

    def __call__(self, event: Event) -> None:
        """Show one."""
        if isinstance(event, Frame):
            self._taken.append((event.stamp.sequence, event.stamp.t_wall_s))
            self._output.publish_image(event)
        elif isinstance(event, RobotSample):
            self._output.publish_joints(event.joints, event.stamp.t_wall_s)
        elif isinstance(event, Result):
            self._tell(event, dict(self._taken).get(event.frame, event.stamp.t_wall_s))

    def _tell(self, result: Result, taken_s: float) -> None:
        """What was computed from a picture, of the time that it was taken at."""
        if result.row.get("accepted") and result.row.get("x_mm") is not None:
            values = [float(result.row[name]) for name in POSE_COLUMNS]
            self._output.publish_pose(transform_from_quaternion(values[:3], values[3:]), taken_s)
        if "coverage" in result.row:
            self._output.publish_coverage(json.loads(result.row["coverage"]), taken_s)
