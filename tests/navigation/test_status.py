"""Navigation in plain words."""

import numpy as np
import pytest

from ursnav_torch.exploration.coverage import GLIMPSED, INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage
from ursnav_torch.exploration.route import Route
from ursnav_torch.geometry import look_along
from ursnav_torch.navigation import Guidance, confidence_words, status_line, turn_words


def covered(*verdicts):
    return tuple(CalyxCoverage("ABCDEFGH"[i], "", v, 0.5, 1.0, 10.0) for i, v in enumerate(verdicts))


def way(points, back_mm=0.0, feasible=True):
    points = np.asarray(points, float)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return Route("F", ("pelvis",), points, length, back_mm, 90.0, 2.0, feasible)


def test_the_line_of_an_exploration_reads_as_people_speak():
    verdicts = covered(*[INSPECTED] * 6, UNSEEN, GLIMPSED)
    guidance = Guidance("calyx C", verdicts, route=way([[0, 0, 0], [0, 0, 24]]), turn="bend left")
    line = status_line("tracking", "C", 0.95, guidance)
    assert line == "In calyx C, sure. 6 of 8 inspected. Next: F, 24 mm, bend left."


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("tracking", "", "pelvis", 0.7, (), None, ""), "In the pelvis, fairly sure."),
        (("tracking", "", "infundibulum to A, B", 0.95, (), None, ""), "In the infundibulum to A, B, sure."),
        (("tracking", "", "calyx A", 0.3, (), None, ""), "On the way into calyx A, unsure."),
        (("searching", "", "pelvis", 0.0, covered(UNSEEN), None, ""), "Searching for the place. 0 of 1 inspected."),
        (("lost", "", "", 0.0, (), None, ""), "Lost: the pictures do not fit this kidney."),
        (
            ("tracking", "A", "calyx A", 0.95, covered(INSPECTED, INSPECTED, OUT_OF_REACH), None, ""),
            "In calyx A, sure. All 2 inspected.",
        ),
        (
            ("tracking", "A", "calyx A", 0.95, (), way([[0, 0, 0], [0, 0, 9]], feasible=False), "bend up", "Slow."),
            "In calyx A, sure. Next: F, 9 mm, bend up, hard to reach. Slow.",
        ),
        (
            ("searching", "", "", 0.0, (), way([[0, 0, 0], [0, 0, 9]]), "bend up"),
            "Searching for the place. Next: F, 9 mm.",
        ),
    ],
)
def test_every_situation_has_its_words(arguments, expected):
    tracking, calyx, place, confidence, coverage, route, turn, *remark = arguments
    guidance = Guidance(place, coverage, route=route, turn=turn)
    assert status_line(tracking, calyx, confidence, guidance, *remark) == expected


@pytest.mark.parametrize(("p", "words"), [(0.9, "sure"), (0.89, "fairly sure"), (0.6, "fairly sure"), (0.59, "unsure")])
def test_confidence_in_words(p, words):
    assert confidence_words(p) == words


@pytest.mark.parametrize(
    ("goal", "words"),
    [((0, 0, 20), "straight on"), ((15, 2, 5), "bend right"), ((-15, 2, 5), "bend left"), ((1, 15, 5), "bend down"),
     ((1, -15, 5), "bend up"), ((-5, 0, -15), "bend left")],
)  # fmt: skip
def test_convention_the_turn_is_as_the_picture_shows_it(goal, words):
    """x to the right and y down in the picture, whatever the camera's attitude in the kidney."""
    for forward in ([0, 0, 1.0], [1.0, 2.0, 0.5], [0, -1.0, 0.1]):
        T = look_along(np.array([3.0, 4.0, 5.0]), np.array(forward))
        points = T[:3, 3] + np.linspace(0, 1, 9)[:, None] * np.array(goal, float) @ T[:3, :3].T
        assert turn_words(T, way(points)) == words


def test_a_way_back_comes_before_any_bend():
    assert turn_words(np.eye(4), way([[0, 0, 0], [0, 0, -9], [9, 0, -9]], back_mm=9.0)) == "pull back 9 mm"
