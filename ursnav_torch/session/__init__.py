"""What came in and went out, kept and played back: `Live` makes the events of a rig, `Recorder` writes them,
`Replay` reads them again, `run_session` works through either, and `hold_session` connects the devices first.
"""

from ursnav_torch.session.control import Control
from ursnav_torch.session.events import Event, Result, Snapshot
from ursnav_torch.session.hold import StatusLine, hold_session
from ursnav_torch.session.live import Live
from ursnav_torch.session.record import Recorder
from ursnav_torch.session.replay import Replay
from ursnav_torch.session.rig import LATER, Rig, build_rig
from ursnav_torch.session.run import Summary, run_session

__all__ = [
    "LATER",
    "Control",
    "Event",
    "Live",
    "Recorder",
    "Replay",
    "Result",
    "Rig",
    "Snapshot",
    "StatusLine",
    "Summary",
    "build_rig",
    "hold_session",
    "run_session",
]
