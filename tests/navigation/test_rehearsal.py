"""Exploring in simulated time."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.autonomy import Explorer, State
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import look_along
from ursnav_torch.navigation.rehearsal import PictureAnswer, Rehearsal, SimulatedOperator
from ursnav_torch.simulation import SimulatedTime, Twin
from ursnav_torch.stones import THERE, FoundStone


def rehearsal(phantom, phantom_lumen, lens, vid, holds=lambda t_s: True):
    start = phantom.centerline.points_mm[0]
    T = look_along(start, phantom.tips_mm.mean(axis=0) - start)
    twin = Twin(phantom_lumen.clearance_mm, lambda T: np.zeros((1, 1), np.uint8), T)
    explorer = Explorer(Coverage(phantom, lens, phantom_lumen, vid.T_kidney_camera[::2]), phantom_lumen)
    clock = SimulatedTime()
    operator = SimulatedOperator(clock, holds)
    return Rehearsal(
        twin, explorer, lambda twin, t_s: PictureAnswer(twin.pose().copy()), operator=operator, clock=clock
    )


@pytest.fixture
def make(phantom, phantom_lumen, lens, vid):
    return lambda **changes: rehearsal(phantom, phantom_lumen, lens, vid, **changes)


@pytest.mark.slow
def test_a_calyx_is_inspected_without_forcing_the_wall(make):
    rehearsed = make()
    found = rehearsed.run(35.0)
    visits = rehearsed.explorer.visits
    assert [v.calyx for v in visits if v.verdict == "inspected"], [v.text() for v in visits]
    assert not [v for v in visits if v.verdict == "not reached"]
    assert sum(found.ways_mm().values()) == pytest.approx(found.path_mm) and found.ways_mm()["approaching"] > 5.0
    assert found.disarmed == 0 and not found.faults and max(found.pressed_mm) < 0.5


def test_the_same_steps_are_made_again(make):
    runs = [make().run(3.0) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].T_kidney_camera, runs[1].T_kidney_camera)
    assert runs[0].states == runs[1].states


def test_it_stands_still_while_the_button_is_released(make):
    rehearsed = make(holds=lambda t_s: t_s < 2.0)
    found = rehearsed.run(4.0)
    places = np.array([T[:3, 3] for T in found.T_kidney_camera])
    t_s = np.array(found.t_s)
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert moved[t_s[1:] < 2.0].sum() > 0.5
    assert moved[t_s[1:] > 2.2].sum() == 0.0  # a fifth of a second for what was sent, and the picture before
    assert rehearsed.explorer.machine.state is State.WAITING


def test_pictures_without_a_place_end_motion_when_the_first_is_answered(make):
    rehearsed = make()
    seen = rehearsed._locate
    rehearsed._locate = lambda twin, t_s: seen(twin, t_s) if t_s < 2.0 else PictureAnswer(None)
    found = rehearsed.run(4.2)
    t_s, states = np.array(found.t_s), np.array(found.states)
    assert set(states[(t_s > 2.25) & (t_s < 4.0)]) == {"looking"}, "0.13 s for the answer, and the picture's own time"
    places = np.array([T[:3, 3] for T in found.T_kidney_camera])[(t_s > 2.5) & (t_s < 4.0)]
    assert np.ptp(places, axis=0).max() == 0.0


def test_stones_that_pictures_told_of_reach_the_explorer(make):
    rehearsed, told = make(), []
    stone = FoundStone(1, 0, np.zeros(3), np.eye(3), 4.0, 0.4, 9, 0.99, THERE, 0)
    seen, step = rehearsed._locate, rehearsed.explorer.step
    rehearsed._locate = lambda twin, t_s: replace(seen(twin, t_s), stones=(stone,) if t_s > 0.3 else ())
    rehearsed.explorer.step = lambda seen, may: told.append((seen.seen_s, seen.stones)) or step(seen, may)
    rehearsed.run(1.0)
    assert {stones for seen_s, stones in told if seen_s <= 0.3} == {()}
    assert {stones for seen_s, stones in told if seen_s > 0.35} == {(stone,)}


def test_wall_behind_what_a_picture_shows_before_it_does_not_count(make):
    """Nothing is painted while a stone fills the picture, or while the place may be too far off."""
    everywhere = ForegroundBody("stone", 0.99, (0.0, 0.0), 1.0, 1.0, np.ones((8, 8), bool))
    for changes, counts in (({}, True), ({"bodies": (everywhere,)}, False), ({"position_sd_mm": 1.0}, False)):
        rehearsed = make()
        seen = rehearsed._locate
        rehearsed._locate = lambda twin, t_s, seen=seen, changes=changes: replace(seen(twin, t_s), **changes)
        rehearsed.run(1.0)
        assert rehearsed.explorer.coverage.seen_s.any() == counts, changes
