"""An exploration from end to end, with the tracker's own places: recorded, and replayed to the same rows."""

from dataclasses import replace

import numpy as np
import pytest
from small_explorations import explore_whole, small_vid

from ursnav_torch.devices import CommandSample, Frame, Limits, Stamp
from ursnav_torch.navigation import Governor, NavigationState, Navigator, run_navigation
from ursnav_torch.navigation.autopilot import Late
from ursnav_torch.page.scene import stone_rows
from ursnav_torch.reports.session import session_values
from ursnav_torch.session import Recorder, Replay
from ursnav_torch.simulation import SimulatedTime
from ursnav_torch.tracking.tracker import Tracker

#: What differs from machine to machine.
TIMES = {"waiting_s", "features_s", "tracking_s", "latency_s"}


def rows_of(record):
    return [(r.frame, {k: v for k, v in r.row.items() if k not in TIMES}) for r in Replay(record, speed=0).results()]


@pytest.mark.slow
def test_a_whole_exploration_is_recorded_and_replayed_to_the_same_rows(phantom, lens, tmp_path):
    vid = small_vid(phantom, lens, tmp_path / "vid")
    found = explore_whole(vid, Recorder(tmp_path / "explored"))
    assert found.explored.finished and found.explored.reason == "every calyx was visited"
    assert {v.verdict for v in found.explored.visits} == {"inspected"}
    assert found.session.lost == {} and found.passed_over == 0 and not found.session.faults
    sent = [e for e in Replay(tmp_path / "explored") if isinstance(e, CommandSample)]
    assert sum(not e.sent.is_zero for e in sent) > 100 and {e.reason for e in sent[1:]} <= {"", "limit"}
    fastest = max(np.hypot(e.sent.bend_x_rad_s, e.sent.bend_y_rad_s) for e in sent)
    assert fastest <= Limits().max_bend_rate_rad_s + 1e-9, "what is asked too fast is sent within the limit"

    again = Navigator(Tracker(vid), governor=Governor(1e-9))  # however late it calls itself
    replayed = run_navigation(again, Replay(tmp_path / "explored", speed=0), recorder=Recorder(tmp_path / "again"))
    first, second = rows_of(tmp_path / "explored"), rows_of(tmp_path / "again")
    assert len(first) == found.pictures > 50 and first == second, "places, calyces, coverage"
    assert sum("coverage" in row for _, row in first) > 10
    assert replayed.last.guidance.coverage == found.last.guidance.coverage
    stones = [stone_rows(summary.last.guidance.stones, vid.kidney) for summary in (found, replayed)]
    assert stones[0] == stones[1]
    told = session_values(vid, Replay(tmp_path / "again", speed=0))
    assert {c["verdict"] for c in told["calyces"]} == {"inspected"}


def test_an_answer_arrives_as_late_as_simulated_time_says():
    clock, states = SimulatedTime(answer_s=0.13), [NavigationState()]
    late = Late(lambda: states[-1], clock)
    frames = [Frame(Stamp(i, 0.1 * i, 0.0), np.zeros((1, 1), np.uint8)) for i in range(3)]
    told = []
    for cycle in range(22):
        clock.now_s = 0.02 * cycle
        if cycle % 5 == 0 and cycle < 15:
            states.append(replace(NavigationState(), frame=frames[cycle // 5]))
        told.append(late().frame)
    first = [next(i for i, frame in enumerate(told) if frame is wanted) for wanted in frames]
    assert first == [7, 12, 17], "0.14, 0.24 and 0.34 s"
