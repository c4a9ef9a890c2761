"""The account: what was tried, what was in the way, and what was seen are three things, and it says each."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import HELD, later

from ursnav_torch.autonomy import Explored, State, Visit

LEAST = (0.1, 0.9)
STONE = "a stone blocks the way"


@pytest.mark.parametrize(
    ("share", "nearest_mm", "blocked", "verdict", "reason"),
    [
        (0.95, 3.0, "", "inspected", ""),
        (0.95, 9.0, STONE, "inspected", ""),  # past the stone
        (0.50, 9.0, STONE, "not reached", STONE),
        (0.00, 9.0, STONE, "not reached", STONE),
        (0.50, 3.0, "", "partly seen", "gave up"),
        (0.05, 3.0, "", "not seen", "gave up"),
        (0.50, np.inf, "", "not tried", "gave up"),
        (0.00, np.inf, "", "not tried", "gave up"),
    ],
)
def test_the_verdict_tells_what_was_in_the_way_from_what_was_not_tried(share, nearest_mm, blocked, verdict, reason):
    visit = Visit("C", share=share, nearest_mm=nearest_mm)
    visit.close(LEAST, "gave up", blocked)
    assert (visit.verdict, visit.reason, visit.share) == (verdict, reason, share)


def test_people_read_the_way_and_the_share_and_files_keep_both():
    visit = Visit("C", share=0.351, nearest_mm=9.04, attempts=3)
    visit.close(LEAST, "", "meets resistance 9 mm before the tip of calyx C")
    assert visit.text() == "C: not reached (meets resistance 9 mm before the tip of calyx C), 35% of its wall seen"
    assert visit.to_dict() == {
        "calyx": "C",
        "verdict": "not reached",
        "share": 0.351,
        "reason": "meets resistance 9 mm before the tip of calyx C",
        "attempts": 3,
        "nearest_mm": 9.0,
    }
    assert "0 of 1 calyces inspected" in Explored((visit,), "gave up", True).text()


def lose(explorer, seen):
    """Without a place until it gives up."""
    for _ in range(2000):
        seen = later(seen, 0.5, T_kidney_camera=None, insertion_mm=max(seen.insertion_mm - 0.5, 0.0))
        explorer.step(seen, HELD)
        if explorer.finished:
            return seen
    raise AssertionError("it never gives up")


def begin(explorer, seen):
    """On the way into the first calyx."""
    while explorer.machine.state is not State.APPROACHING or not explorer.visits[explorer.target].tried:
        seen = later(seen, 0.1)
        explorer.step(seen, HELD)
    return seen


def see(explorer, calyx, part):
    """Paint a part of what can be seen of a calyx's wall."""
    own = np.flatnonzero((explorer.coverage.patches.calyx == calyx) & explorer.coverage.in_reach)
    explorer.coverage.seen_s[own[: round(part * len(own))]] = 9.0


def test_who_gives_up_without_a_place_has_not_tried_the_calyces_it_never_headed_for(explorer, at_root):
    seen = begin(explorer, at_root)
    target, others = explorer.target, [c for c in range(6) if c != explorer.target]
    see(explorer, others[0], 0.5)
    see(explorer, others[1], 1.0)
    lose(explorer, seen)
    visits = explorer.account().visits
    assert visits[target].verdict == "not seen"
    assert visits[others[0]].verdict == "not tried" and 0.2 < visits[others[0]].share < 0.9
    assert visits[others[1]].verdict == "inspected", "seen in passing"
    assert {visits[c].verdict for c in others[2:]} == {"not tried"}
    assert {visits[c].reason for c in (target, *others[2:])} == {"gave up: no place from the pictures"}


def lose_again_and_again(explorer, seen, at_root):
    """On the way to the target, until it is left."""
    target = explorer.target
    for loss in range(explorer.settings.attempts):
        assert explorer.target == target, f"left after {loss} losses"
        while explorer.machine.state is not State.WITHDRAWING:
            seen = later(seen, 0.5, T_kidney_camera=None)
            explorer.step(seen, HELD)
        while explorer.machine.state in (State.WITHDRAWING, State.LOOKING):
            seen = later(seen, 0.1, T_kidney_camera=at_root.T_kidney_camera)
            explorer.step(seen, HELD)
    return seen


def test_a_calyx_on_whose_way_the_place_is_lost_again_and_again_is_left_for_later(explorer, at_root):
    seen = begin(explorer, at_root)
    first = explorer.target
    seen = lose_again_and_again(explorer, seen, at_root)
    assert explorer.target not in (first, -1) and not explorer.finished
    assert explorer.visits[first].verdict == "open" and explorer.visits[first].attempts == 1
    for calyx, visit in enumerate(explorer.visits):
        if calyx not in (first, explorer.target) and visit.verdict == "open":
            explorer.leave_out(calyx, STONE)
    second = explorer.target
    seen = lose_again_and_again(explorer, seen, at_root)
    assert explorer.target == first, "comes back when all others were tried"
    seen = lose_again_and_again(explorer, seen, at_root)
    assert explorer.visits[first].reason == "the place was lost 3 times on the way there", "and leaves it for good"
    assert explorer.target == second
    lose_again_and_again(explorer, seen, at_root)
    assert explorer.finished and explorer.visits[second].reason == explorer.visits[first].reason


def test_a_calyx_that_resists_is_not_reached_for_that_reason_and_what_was_seen_of_it_is_told(explorer, at_root):
    seen = begin(explorer, at_root)
    target = explorer.target
    see(explorer, target, 0.5)
    steps = {State.APPROACHING: (0.1, 0.3), State.BACKING_OFF: (0.1, -0.5)}
    for _ in range(3000):
        seconds, push = steps.get(explorer.machine.state, (1.0, 0.0))
        seen = later(seen, seconds, insertion_mm=max(seen.insertion_mm + push, 5.0))
        explorer.step(seen, HELD)
        if explorer.target != target:
            break
    visit = explorer.visits[target]
    assert visit.verdict == "not reached" and visit.attempts == explorer.settings.attempts
    assert visit.reason.startswith("meets resistance") and visit.reason.endswith(f"the tip of calyx {visit.calyx}")
    assert 0.2 < visit.share < 0.9


def test_a_calyx_left_out_is_not_reached_with_the_share_that_was_seen(explorer):
    see(explorer, 2, 0.5)
    explorer.leave_out(2, STONE)
    assert explorer.visits[2].verdict == "not reached" and 0.2 < explorer.visits[2].share < 0.9
    explorer.leave_out(2, "another reason")
    assert explorer.visits[2].reason == STONE


def test_an_exploration_that_is_cut_off_is_accounted_for_and_can_still_go_on(explorer, at_root):
    seen = begin(explorer, at_root)
    told = explorer.account()
    assert not told.finished and "Not explored to the end" in told.text()
    assert told.visits[explorer.target].verdict == "not seen"
    assert sum(v.verdict == "not tried" for v in told.visits) == 5
    assert {v.reason for v in told.visits} == {f"ended while approaching: {explorer.machine.reason}"}
    assert {v.verdict for v in explorer.visits} == {"open"}
    explorer.step(later(seen, 0.1), HELD)
    assert explorer.machine.state is State.APPROACHING


@pytest.mark.parametrize(("slack_mm", "expected"), [(None, 1.2), (0.2, 0.2), (2.0, 2.0)])
def test_resistance_counts_from_where_the_sliders_play_ends_as_it_was_learned(explorer, at_root, slack_mm, expected):
    seen = begin(explorer, replace(at_root, slack_mm=slack_mm))
    first = seen.insertion_mm
    while explorer.machine.state is State.APPROACHING:
        seen = later(seen, 0.02, insertion_mm=seen.insertion_mm + 0.05)
        explorer.step(seen, HELD)
    assert explorer.machine.state is State.BACKING_OFF and explorer.machine.reason.startswith("meets resistance")
    smoothed_mm = 2.5 * 0.23  # speed and time constant: pictures are smoothed
    so_far = expected + explorer.settings.resistance_mm + smoothed_mm
    assert seen.insertion_mm - first == pytest.approx(so_far, abs=0.06)


@pytest.mark.parametrize("state", [State.APPROACHING, State.INSPECTING])
def test_a_picture_that_is_too_bright_means_that_the_wall_is_near_and_it_backs_off(explorer, at_root, state):
    seen = begin(explorer, at_root)
    if state is State.INSPECTING:
        T = seen.T_kidney_camera.copy()
        T[:3, 3] = explorer._ways[explorer.target].points_mm[-3]
        while explorer.machine.state is not state:
            seen = later(seen, 0.1, T_kidney_camera=T)
            explorer.step(seen, HELD)
    explorer.step(later(seen, 0.02, glare=0.45), HELD)
    assert explorer.machine.state is state, "bright, but something is to be seen"
    wish = explorer.step(later(seen, 0.04, glare=0.6), HELD)
    assert explorer.machine.state is State.BACKING_OFF and "too bright" in explorer.machine.reason
    assert wish.insertion_mm_s < 0, "back"
