"""The state machine: only legal transitions, and in every state an end of permission or of certainty ends motion."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import HELD, later

from ursnav_torch.autonomy import MOVING, TRANSITIONS, Permission, State, StateMachine, Wish
from ursnav_torch.autonomy.states import IllegalTransitionError
from ursnav_torch.autonomy.visits import OPEN


def test_every_state_can_be_reached_and_left_but_the_last():
    reached = set().union(*TRANSITIONS.values())
    assert TRANSITIONS.keys() == set(State) == reached
    assert [s for s in State if not TRANSITIONS[s]] == [State.FINISHED]
    for state in MOVING:
        assert {State.WAITING, State.STOPPED, State.LOOKING} <= TRANSITIONS[state]


@pytest.mark.parametrize("first", list(State))
@pytest.mark.parametrize("then", list(State))
def test_only_legal_transitions_are_made(first, then):
    machine = StateMachine(first)
    if then in TRANSITIONS[first] or then is first:
        machine.to(then, 1.0, "why")
        assert (machine.state, machine.reason) == (then, "why")
    else:
        with pytest.raises(IllegalTransitionError, match=f"'{then.value}' may not follow '{first.value}'"):
            machine.to(then, 1.0)
        assert machine.state is first


def test_no_stop_is_left_for_motion():
    assert TRANSITIONS[State.STOPPED] == {State.WAITING}
    assert TRANSITIONS[State.WAITING].isdisjoint(MOVING)


def in_state(explorer, seen, state):
    """Lead an explorer to a state by what it is told; returns what it was told last."""
    steps = iter(range(1000))

    def tell(seconds=0.1, **changes):
        nonlocal seen
        seen = later(seen, seconds, **changes)
        explorer.step(seen, HELD)
        return next(steps)

    tell()
    if state is State.WITHDRAWING:
        for seconds in (1.0, 5.0, 0.1):
            tell(seconds, T_kidney_camera=None)
        return seen
    while explorer.machine.state is not State.APPROACHING:
        assert tell() < 10
    way = explorer._ways[explorer.target]
    T = seen.T_kidney_camera.copy()
    T[:3, 3] = way.points_mm[-3]
    if state is State.RETREATING:  # from deep in a calyx that is not wanted any more
        explorer.leave_out(explorer.target, "a stone blocks the way")
        while explorer.machine.state is not state:
            assert tell(T_kidney_camera=T) < 20
        assert explorer.target >= 0 and explorer._ways[explorer.target] is not way
    if state is State.BACKING_OFF:
        tell(20.0, insertion_mm=seen.insertion_mm + 6.0)
    if state is State.INSPECTING:
        while explorer.machine.state is not state:
            assert tell(T_kidney_camera=T, insertion_mm=12.0) < 100
    return seen


def test_who_was_led_into_a_calyx_comes_back_out_of_it_first(explorer, at_root):
    explorer.leave_out(0, "it is where the operator led")
    T = at_root.T_kidney_camera.copy()
    T[:3, 3] = explorer._ways[0].points_mm[-3]
    led_in = replace(at_root, T_kidney_camera=T, insertion_mm=20.0)
    for n in range(1, 6):
        wish = explorer.step(later(led_in, 0.1 * n), HELD)
    assert explorer.machine.state is State.RETREATING and explorer.target != 0
    assert wish.insertion_mm_s < 0


def test_where_the_operator_took_the_scope_meanwhile_is_seen_anew(explorer, at_root):
    seen = in_state(explorer, at_root, State.APPROACHING)
    explorer.step(later(seen, 0.1), Permission(held=False, armed=True))
    elsewhere = (explorer.target + 3) % 6
    T = seen.T_kidney_camera.copy()
    T[:3, 3] = explorer._ways[elsewhere].points_mm[-3]
    for n in range(2, 6):
        wish = explorer.step(later(seen, 0.1 * n, T_kidney_camera=T, insertion_mm=20.0), HELD)
    assert explorer.machine.state is State.RETREATING and wish.insertion_mm_s < 0


@pytest.mark.parametrize("state", sorted(MOVING))
@pytest.mark.parametrize("end", ["released", "stopped", "disarmed", "no place", "doubt", "silence", "two calyces"])
def test_in_every_state_of_motion_whatever_ends_it_ends_it_at_once(explorer, at_root, state, end):
    seen = in_state(explorer, at_root, state)
    assert explorer.machine.state is state
    if state is not State.INSPECTING:  # which may stand and weigh views
        assert not explorer.step(later(seen, 0.02), HELD).is_still, "the test must begin in motion"
    seen = later(seen, 0.04)
    may = {
        "released": Permission(held=False, armed=True),
        "stopped": Permission(held=True, armed=True, stopped=True),
        "disarmed": Permission(held=True, armed=False),
    }.get(end, HELD)
    told = {
        "no place": {"T_kidney_camera": None},
        "doubt": {"position_sd_mm": 9.0},
        "two calyces": {"calyces": (explorer.target, (explorer.target + 1) % 6)},
    }.get(end, {})
    seen = later(seen, 0.02, **told)
    if end == "silence":  # the newest picture grows old
        seen = replace(seen, t_s=seen.seen_s + 2.0)
    wish = explorer.step(seen, may)
    expected = {"released": State.WAITING, "stopped": State.STOPPED, "disarmed": State.WAITING}.get(end, State.LOOKING)
    if state is State.WITHDRAWING and expected is State.LOOKING:  # it is there because of doubt, and goes back in it
        assert explorer.machine.state in (State.WITHDRAWING, State.LOOKING) and wish.insertion_mm_s <= 0
        return
    assert explorer.machine.state is expected and wish.is_still
    assert explorer.machine.reason


def test_after_a_stop_it_waits_looks_and_only_then_goes_on(explorer, at_root):
    seen = in_state(explorer, at_root, State.APPROACHING)
    target = explorer.target
    explorer.step(seen, Permission(stopped=True))
    states = []
    for n in range(4):
        explorer.step(later(seen, 0.02 * n), HELD)
        states.append(explorer.machine.state)
    assert states[:3] == [State.WAITING, State.LOOKING, State.RETREATING]
    assert explorer.target == target


def test_a_finished_exploration_stays_so(explorer, at_root):
    for calyx in range(6):
        explorer.leave_out(calyx, "a stone blocks the way")
    for n in range(4):
        assert explorer.step(later(at_root, 0.02 * n), HELD).is_still
    assert explorer.finished
    assert {v.reason for v in explorer.visits} == {"a stone blocks the way"}
    assert explorer.step(later(at_root, 1.0), Permission(stopped=True)).is_still and explorer.finished


def test_two_calyces_in_sight_of_a_sure_place_are_no_doubt(explorer, at_root):
    seen = in_state(explorer, at_root, State.APPROACHING)
    both = (explorer.target, (explorer.target + 1) % 6)
    explorer.step(later(seen, 0.02, calyces=both, position_sd_mm=0.4), HELD)
    assert explorer.machine.state is State.APPROACHING
    explorer.step(later(seen, 0.04, calyces=both, position_sd_mm=1.5), HELD)
    assert explorer.machine.state is State.LOOKING


@pytest.mark.parametrize("state", sorted(set(State) - MOVING))
def test_no_wish_gets_out_of_a_state_that_does_not_move(explorer, at_root, state, monkeypatch):
    monkeypatch.setattr(explorer, "_act", lambda seen, doubt: Wish(np.array([0.1, 0.0]), 1.0))
    monkeypatch.setattr(explorer, "_permit", lambda seen, may: None)
    explorer.machine.state = state
    assert explorer.step(at_root, HELD).is_still


@pytest.mark.parametrize(("moved_mm", "withdraws", "then"), [
    (0.5, False, State.INSPECTING), (6.0, False, State.RETREATING), (0.5, True, State.RETREATING),
])  # fmt: skip
def test_an_inspection_that_a_doubt_broke_off_goes_on_where_it_stood(explorer, at_root, moved_mm, withdraws, then):
    """From somewhere else, as after withdrawing, it is the way in that comes first."""
    seen = in_state(explorer, at_root, State.INSPECTING)
    explorer.step(seen := later(seen, 0.1, position_sd_mm=4.0), HELD)
    assert explorer.machine.state is State.LOOKING
    if withdraws:
        explorer.step(seen := later(seen, 2.5), HELD)
        assert explorer.machine.state is State.WITHDRAWING
    T = seen.T_kidney_camera.copy()
    T[:3, 3] += [0.0, 0.0, moved_mm]
    states = []
    for _ in range(2 + withdraws):
        explorer.step(seen := later(seen, 0.1, position_sd_mm=0.2, T_kidney_camera=T), HELD)
        states.append(explorer.machine.state)
    assert then in states and (then is not State.INSPECTING or State.RETREATING not in states), states


@pytest.mark.parametrize(("before_mm", "blocked", "goes_in"), [(6.0, "", True), (1.0, "", False), (6.0, "why", False)])
def test_an_inspection_that_views_drew_back_goes_in_once_more(explorer, at_root, before_mm, blocked, goes_in):
    seen = in_state(explorer, at_root, State.INSPECTING)
    inspection, target, explorer._blocked = explorer._inspection, explorer.target, blocked
    inspection._in_vain[3] = 2
    inspection.step = lambda *_: None  # no view shows more
    way, T = explorer._ways[target], seen.T_kidney_camera.copy()
    T[:3, 3] = way.point_at(way.length_mm - explorer.settings.standoff_mm - before_mm)
    explorer.step(seen := later(seen, 0.1, T_kidney_camera=T), HELD)
    assert (explorer.machine.state is State.APPROACHING and explorer.target == target) is goes_in
    assert (not inspection._in_vain) is (goes_in or explorer.target != target)
    if goes_in:
        explorer._look_around(seen)
        explorer.step(later(seen, 0.1), HELD)
        assert explorer.visits[target].verdict != OPEN, "and no more than once"


def test_it_retreats_bent_as_on_the_way_in(explorer, at_root):
    seen = in_state(explorer, at_root, State.RETREATING)
    for bend, insertion in ((0.4, seen.insertion_mm - 2.0), (0.9, seen.insertion_mm)):
        explorer._way_back.add(np.array([bend, 0.0, insertion]))
    wish = explorer.step(later(seen, 0.02, bend_rad=np.array([0.9, 0.0])), HELD)
    assert explorer.machine.state is State.RETREATING and wish.insertion_mm_s < 0
    assert wish.bend_rad_s == pytest.approx([-0.5 * explorer.settings.turn_per_s, 0.0])
