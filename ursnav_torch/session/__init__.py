"""What came in and went out, kept and played back: `Live` makes the events of a rig, `Stepped` those of one in
simulated time, `Recorder` writes them, `Replay` reads them again, `open_session` connects any of these, and
`run_session` is the loop that works through it.
"""

from ursnav_torch.session.console import HOLD, MOVES, Console
from ursnav_torch.session.control import Control
from ursnav_torch.session.events import Event, Result, Snapshot
from ursnav_torch.session.live import Live
from ursnav_torch.session.open import Session, SessionControls, open_session
from ursnav_torch.session.player import Player
from ursnav_torch.session.record import Recorder
from ursnav_torch.session.replay import Replay
from ursnav_torch.session.rig import Rig, build_rig
from ursnav_torch.session.run import Observer, Summary, Worker, run_session
from ursnav_torch.session.source import EventSource, Pace
from ursnav_torch.session.status_line import StatusLine
from ursnav_torch.session.stepped import Stepped, rehearse

__all__ = [
    "HOLD",
    "MOVES",
    "Console",
    "Control",
    "Event",
    "EventSource",
    "Live",
    "Observer",
    "Pace",
    "Player",
    "Recorder",
    "Replay",
    "Result",
    "Rig",
    "Session",
    "SessionControls",
    "Snapshot",
    "StatusLine",
    "Stepped",
    "Summary",
    "Worker",
    "build_rig",
    "open_session",
    "rehearse",
    "run_session",
]
