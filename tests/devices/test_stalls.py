"""A busy machine stalls between any two deeds of a driver: the true place stays within the bounds that are told.

In simulated time (see `slow_line`), so that each race is a schedule.
"""

import threading

import pytest
from slow_line import slow_line

from benchmarks.safety.bench import KINDS
from benchmarks.safety.resets import LIMITS, OFF_MM
from ursnav_torch.devices import JointRates, Joints
from ursnav_torch.errors import DeviceProtocolError, DeviceTimeoutError

FORWARD = JointRates(insertion_mm_s=8.0)


@pytest.fixture
def line(request, monkeypatch):
    with slow_line(getattr(request, "param", "grbl"), LIMITS, monkeypatch) as line:
        assert line.robot.arm()
        yield line


def in_and_out(kind, stalled, stall_s, monkeypatch):
    """Drive in and out with a stall before the ``stalled``-th deed, be reset in silence, recover; None past the end."""
    with slow_line(kind, LIMITS, monkeypatch) as line:
        connected = len(line.deeds)
        line.stalls = {connected + stalled: stall_s}
        line.robot.arm()
        line.drive(8.0, 0.2)
        line.drive(-8.0, 0.1)
        if len(line.deeds) - connected < stalled:
            return None
        line.reset(heard=False)
        said, true, slack = line.recover()
        false = [f"said {said:.2f}, true {true:.2f}, slack {slack:.2f} mm"] if abs(said - true) > slack + OFF_MM else []
        return line.outside + false


@pytest.mark.parametrize("stall_s", [0.2, 0.3])
@pytest.mark.parametrize("kind", KINDS)
def test_wherever_the_machine_stalls_the_bounds_hold(kind, stall_s, monkeypatch):
    stalled, found = 0, []
    while found is not None:
        stalled += 1
        found = in_and_out(kind, stalled, stall_s, monkeypatch)
        assert not found, f"stalled before deed {stalled}: {found}"
    assert stalled > 30


@pytest.mark.parametrize("late", ["the jog", "the report"])
def test_what_is_left_of_a_jog_after_a_late_report_is_in_the_slack(line, late):
    """The false place that a busy machine once showed: a report in mid-jog was believed to tell the jog's end."""
    robot = line.robot
    if late == "the jog":
        line.stalls = {len(line.deeds) + 1: 0.3}
    robot.command(FORWARD, True)
    line.sleep(0.02)
    if late == "the report":
        line.stalls = {len(line.deeds) + 3: 0.3}  # asked for, answered, and not looked at
    assert robot.read().moving
    line.sleep(0.2)
    line.reset(heard=False)
    said, true, slack = line.recover()
    assert line.outside == [] and abs(said - true) <= slack + OFF_MM


@pytest.mark.parametrize("line", KINDS, indirect=True)
def test_the_last_words_of_a_board_that_fell_silent_are_as_old_as_they_are(line):
    """It reports in mid-motion, goes on and hangs; the machine looks only when all orders should be over."""
    robot = line.robot
    line.drive(8.0, 0.2)
    line.sleep(0.06)  # one more report, in mid-motion
    line.board.answering = False
    line.sleep(0.3)
    with pytest.raises(DeviceTimeoutError):
        robot.read()
    line.sleep(0.1)
    assert line.outside == []


@pytest.mark.parametrize("line", ["rosserial"], indirect=True)
def test_a_machine_too_busy_to_know_how_old_a_report_is_looks_again_and_calls_no_board_hung(line):
    line.drive(8.0, 0.2)
    line.stalls = {len(line.deeds) + n: 0.12 for n in range(1, 7)}
    assert line.robot.read().place_known and line.outside == []
    line.robot.command(FORWARD, True)
    assert line.robot.gate.state == "armed"


def test_a_jog_cancelled_by_the_guardian_is_missed_by_no_bound(line):
    """Its process writes to the port by itself: this program hears nothing of it."""
    line.robot.command(FORWARD, True)
    line.sleep(0.03)
    line.board.handle(b"\x85")
    line.sleep(0.05)
    line.robot.read()
    line.drive(-8.0, 0.2)
    line.sleep(0.3)
    assert line.outside == [] and line.robot.place.is_known and line.true_axes()[2] > -OFF_MM


def test_a_board_reset_in_silence_is_doubted_by_a_command_that_a_stop_has_overtaken(line, monkeypatch):
    """Its counts fit, and the stop has wiped the mark: believed, they would be 0.9 mm off."""
    robot, ahead = line.robot, line.robot._joints_ahead
    robot.command(FORWARD, True)
    line.sleep(0.3)
    line.reset(heard=False)

    def overtaken():
        robot.emergency_stop("another thread")
        return ahead()

    monkeypatch.setattr(robot, "_joints_ahead", overtaken)
    robot.command(FORWARD, True)
    said, true, slack = line.recover()
    assert true > 0.8 and abs(said - true) <= slack + OFF_MM


def test_a_place_that_was_told_while_the_board_was_reset_is_not_taken(line):
    robot, handle = line.robot, line.board.handle

    def reset_after_the_report(data):
        if data.startswith(b"?"):
            report = handle(data[:1])
            line.reset(heard=False)
            return report + handle(data[1:])
        return handle(data)

    line.sleep(0.1)
    mark = robot._mark

    def marked():
        line.board.handle = handle
        robot._ask("F1234")
        line.board.handle = reset_after_the_report
        return mark()

    robot._mark = marked
    with pytest.raises(DeviceProtocolError, match="once more"):
        robot.set_place(Joints(insertion_mm=1.0))
    assert robot.gate.state == "stopped"


@pytest.mark.parametrize("line", KINDS, indirect=True)
@pytest.mark.parametrize("what", ["read", "command", "set_place", "confirm_place", "set_light"])
def test_nobody_talks_to_a_controller_between_a_fault_and_the_stop(line, what, monkeypatch):
    """Answers that are late come among those to another thread's question."""
    robot, stop, free = line.robot, line.robot.emergency_stop, []

    def stopped(reason):
        other = threading.Thread(target=lambda: free.append(robot._lock.acquire(blocking=False)))
        other.start()
        other.join()
        stop(reason)

    def late(*_):
        raise DeviceTimeoutError("late")

    if what == "confirm_place":
        robot.place.lose("reset")
    for name in ("_read_axes", "_joints_ahead", "_recount", "_come_to_rest", "_boards"):
        monkeypatch.setattr(robot, name, late, raising=False)
    monkeypatch.setattr(robot, "_kill", lambda: None)
    monkeypatch.setattr(robot, "emergency_stop", stopped)
    say = {"command": (FORWARD, True), "set_place": (Joints(),), "set_light": (0.5,)}
    with pytest.raises(DeviceTimeoutError, match="late"):
        getattr(robot, what)(*say.get(what, ()))
    assert free == [False] and robot.gate.state == "stopped"
    monkeypatch.undo()
