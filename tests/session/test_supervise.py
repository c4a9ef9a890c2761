"""Device threads are supervised: whatever goes wrong is said, the device is sought again, and nobody says none lost."""

import threading

import pytest

from ursnav_torch.devices import CommandSample, EmTracker, Gamepad, Note, OperatorInput, SourceAtEndError, TrackerSample
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError
from ursnav_torch.session import Live, Rig, Summary, run_session, supervise
from ursnav_torch.session.supervise import Supervisor


class Script(EmTracker):
    """Does what it is told, reading by reading: an exception is raised, a number is a sample of that frame."""

    def __init__(self, *steps, refusals=()):
        super().__init__()
        self.steps, self.refusals, self.opened, self.closed = list(steps), list(refusals), 0, 0

    def _open(self):
        if self.opened and self.refusals:
            raise self.refusals.pop(0)
        self.opened += 1

    def _close(self):
        self.closed += 1

    def read(self, timeout_s=1.0):
        step = self.steps.pop(0) if self.steps else SourceAtEndError("at the end")
        if isinstance(step, Exception):
            raise step
        return TrackerSample(self._stamp(), True, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), source_frame=step)


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    monkeypatch.setattr(supervise, "FIRST_PAUSE_S", 0.02)


def through(tracker, seconds=1.0):
    found = []
    with Rig(tracker=tracker) as rig:
        summary = run_session(Live(rig, duration_s=seconds), None, [found.append])
    return summary, [e.text for e in found if isinstance(e, Note)], [e for e in found if isinstance(e, TrackerSample)]


@pytest.mark.parametrize(
    "error",
    [ValueError("bad matrix"), ZeroDivisionError("x"), IndexError(), UnicodeEncodeError("ascii", "ä", 0, 1, "")],
)
def test_a_drivers_own_mistake_is_said_and_the_sensor_comes_back(error):
    tracker = Script(0, 1, error, 2, 3)
    summary, notes, samples = through(tracker)
    assert notes[0].startswith(f"Script: {type(error).__name__}") and "connected again after" in notes[1]
    assert len(samples) == 4 and tracker.opened == 2
    assert "none lost" not in summary.text() and "1 device faults, the first: Script" in summary.text()
    assert "Script gave nothing for" in summary.text()


def test_none_lost_is_said_when_none_was():
    summary, _, _ = through(Script(0, 1, 2))
    assert summary.text().endswith("3 EM samples; none lost")
    summary, _, _ = through(Script(0, 1, 4))
    assert "2 EM samples lost" in summary.text()


def test_numbers_that_begin_anew_after_a_reconnection_are_no_loss():
    summary, _, samples = through(Script(100, 101, DeviceNotConnectedError("unplugged"), 0, 1))
    assert summary.lost == {} and len(samples) == 4


def test_a_device_that_does_not_come_back_is_sought_with_growing_pauses(monkeypatch):
    waits = []

    class Clock(threading.Event):
        def wait(self, timeout=None):
            waits.append(timeout)
            return len(waits) > 8

    monkeypatch.setattr(supervise, "FIRST_PAUSE_S", 0.5)
    tracker = Script(refusals=[DeviceNotConnectedError("gone")] * 20)
    tracker.connect()
    Supervisor(lambda *_: None, Clock())._reconnect(tracker, "Script", 0.0)
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 15.0, 15.0, 15.0]


def test_ten_protocol_errors_in_a_row_connect_anew():
    tracker = Script(0, *[DeviceProtocolError("checksum")] * 10, 1)
    _, _, samples = through(tracker)
    assert tracker.opened == 2 and len(samples) == 2


class Mad(Gamepad):
    """A gamepad whose driver fails in a way that nobody thought of."""

    def __init__(self):
        super().__init__()
        self.reads = 0

    def _open(self): ...
    def _close(self): ...
    def read(self):
        self.reads += 1
        if self.reads == 5:
            raise ZeroDivisionError("axis")
        return OperatorInput(self._stamp(), quit=self.reads == 20)


def test_the_control_cycle_survives_its_gamepad():
    hands, found = Mad(), []
    with Rig(gamepad=hands) as rig:
        run_session(Live(rig, duration_s=20.0), None, [found.append])
    assert hands.reads >= 20
    assert any("ZeroDivisionError: axis" in e.text for e in found if isinstance(e, Note))
    assert not any(isinstance(e, CommandSample) for e in found)


def test_a_summary_without_anything_says_so():
    assert Summary().text() == "0.0 s: nothing; none lost"
