"""Stones while it is navigated: from a picture's regions to the state that everybody looks at."""

import time

import numpy as np
import pytest
from stone_views import answer, ball_bodies, ball_on_wall, stone_watch, way_in

from ursnav_torch.camera import Camera
from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.navigation import Guide, Navigator, status_line
from ursnav_torch.navigation.guide import STONES_S
from ursnav_torch.stones import NO_STONES, KnownStone, stone_count
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid

RADIUS = 1.6
BLACK = np.zeros((96, 96), np.uint8)


@pytest.fixture
def guide(vid: Vid, phantom_lumen: LumenDistance, lens: Camera) -> Guide:
    return Guide(vid, phantom_lumen, stone_watch(vid.kidney, phantom_lumen, lens))


def fly(guide: Guide, lens: Camera, calyx: int, begin_s: float, there: bool = True, seed: int = 0) -> np.ndarray:
    """Look at a stone in a calyx, or at where it was, on the way in; its middle."""
    kidney, lumen = guide.kidney, guide.watch.stones.lumen
    center = ball_on_wall(kidney, lumen, calyx, RADIUS)
    for i, T in enumerate(way_in(kidney, calyx, 24, seed)):
        bodies = ball_bodies(lens, lumen, T, [(center, RADIUS)] if there else [])
        guide.see_stones(answer(T, bodies), BLACK, begin_s + 0.3 * i, i)
    guide.see_stones(answer(T, bodies), BLACK, begin_s + 0.3 * i + STONES_S, i + 1)
    return center


def test_a_stone_seen_is_in_the_guidance_and_in_words(guide: Guide, lens: Camera) -> None:
    assert guide.guidance(None).stones is NO_STONES and stone_count(NO_STONES) == ""
    center = fly(guide, lens, 0, 0.0)
    told = guide.guidance(None).stones
    (stone,) = told.seen
    assert stone.calyx == 0 and np.linalg.norm(stone.center_mm - center) < 0.4
    assert "1 stone left." in status_line("tracking", "A", 0.95, guide.guidance(None))
    assert guide.guidance(None).stones is told, "computed again only where pictures came"


def test_a_stone_taken_out_is_said_to_be_gone(guide: Guide, lens: Camera) -> None:
    fly(guide, lens, 2, 0.0)
    for visit in (1, 2):
        fly(guide, lens, 2, 100.0 * visit, there=False, seed=visit)
    assert stone_count(guide.guidance(None).stones) == "No stones left, 1 gone."


def test_places_are_computed_again_once_a_second_and_when_a_replay_goes_back(
    guide: Guide, lens: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    monkeypatch.setattr(guide.watch, "found", lambda: asked.append(now) or NO_STONES)
    T = way_in(guide.kidney, 0, 4)[0]
    for now in (10.0, 10.1, 10.9, 11.1, 11.2, 3.0):
        guide.see_stones(answer(T, ()), BLACK, now, 0)
    assert asked == [10.0, 11.1, 3.0]


def test_the_loop_feeds_the_stones_and_publishes_them(
    vid: Vid, phantom_lumen: LumenDistance, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = KnownStone("S1", ball_on_wall(vid.kidney, phantom_lumen, 0, RADIUS), 2 * RADIUS)
    navigator = Navigator(Tracker(vid), known_stones=(known,))
    small, poses = navigator.tracker.working_camera, way_in(vid.kidney, 0, 16)
    answers = iter([answer(T, ball_bodies(small, phantom_lumen, T, [(known.center_mm, RADIUS)])) for T in poses])
    monkeypatch.setattr(navigator.tracker, "extract", lambda *given: None)
    monkeypatch.setattr(navigator.tracker, "follow", lambda *given: next(answers))
    taken = []
    see = navigator.guide.see_stones
    monkeypatch.setattr(navigator.guide, "see_stones", lambda *given: (see(*given), taken.append(given[3])))
    with navigator:
        for i in range(len(poses)):
            navigator.take(Frame(Stamp(i, 1.1 * i, 1e9 + i), BLACK))
            until = time.monotonic() + 30
            while i not in taken and time.monotonic() < until:
                time.sleep(0.005)
    assert taken == list(range(len(poses)))
    found = navigator.guide.watch.found()
    assert found.known == ("S1",) and found.not_found == () and found.seen[0].calyx == 0


def test_a_fault_of_one_pictures_stones_leaves_coverage_and_the_way(
    vid: Vid, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    navigator = Navigator(Tracker(vid))

    def fails(*given: object) -> None:
        raise ValueError("no such ball")

    monkeypatch.setattr(navigator.guide, "see_stones", fails)
    navigator._see_stones(answer(np.eye(4), ()), Frame(Stamp(7, 0.0, 0.0), BLACK))
    assert "picture 7: its stones could not be placed" in caplog.text
