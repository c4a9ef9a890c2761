"""Autonomy's hands: what the operator holds and touches decides, and the robot's gate has the last word."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ursnav_torch.autonomy import AutonomySettings, Perception, State, Wish
from ursnav_torch.devices import Frame, Gamepad, OperatorInput, Stamp
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.navigation.autopilot import Autopilot, glare_share, make_autopilot
from ursnav_torch.navigation.state import Guidance, NavigationState
from ursnav_torch.simulation import SteppedRobot
from ursnav_torch.stones import THERE, FoundStone, StoneList

STAMP = Stamp(0, 0.0, 0.0)


class Hands(Gamepad):
    """Says what it was told to say."""

    def __init__(self):
        super().__init__()
        self.now = OperatorInput(STAMP)

    def read(self):
        return self.now

    def _open(self): ...

    def _close(self): ...


class Wishing:
    """An explorer that always wishes for the same where it may."""

    def __init__(self, mode="explore"):
        self.settings, self.finished, self.may = AutonomySettings(mode=mode), False, None
        self.machine = type("Machine", (), {"state": State.APPROACHING, "reason": "into calyx C"})()

    def step(self, seen, may):
        self.may = may
        moves = may.held and may.armed and not may.stopped
        return Wish(np.array([3.0, -4.0]), 4.0) if moves else Wish()


@pytest.fixture
def rig():
    robot, hands = SteppedRobot(lambda: 0.0), Hands()
    told = []

    def make(mode="explore", quits=False):
        pilot = Autopilot(hands, robot, Wishing(mode), lambda robot: Perception(0.0), told.append, quits)
        pilot.connect()
        return pilot

    with robot:
        yield make, robot, hands, told


def test_nothing_is_wished_for_unless_the_button_is_held_and_the_robot_armed(rig):
    make, robot, hands, _ = rig
    pilot = make()
    hands.now = OperatorInput(STAMP, dead_man=True)
    assert pilot.read() == hands.now, "disarmed"
    robot.arm()
    hands.now = OperatorInput(STAMP)
    assert pilot.read() == hands.now, "released"
    hands.now = OperatorInput(STAMP, dead_man=True, emergency_stop=True)
    assert pilot.read() == hands.now and pilot.explorer.may.stopped


def test_wishes_become_sticks_inside_the_caps_and_a_bend_keeps_its_direction(rig):
    make, robot, hands, told = rig
    pilot = make()
    robot.arm()
    hands.now = OperatorInput(STAMP, dead_man=True)
    sticks = pilot.read()
    assert np.hypot(sticks.bend_x, sticks.bend_y) == pytest.approx(1.0)
    assert sticks.bend_x / sticks.bend_y == pytest.approx(-3 / 4)
    assert sticks.insertion == pytest.approx(4.0 / robot.limits.max_insertion_rate_mm_s)
    assert sticks.dead_man
    pilot.read()
    assert told == ["approaching: into calyx C"], "said once"


@pytest.mark.parametrize("stick", ["bend_x", "bend_y", "insertion"])
def test_a_stick_that_is_moved_takes_over(rig, stick):
    make, robot, hands, _ = rig
    pilot = make()
    robot.arm()
    hands.now = replace(OperatorInput(STAMP, dead_man=True), **{stick: 0.2})
    assert pilot.read() == hands.now and not pilot.explorer.may.held


def test_with_assist_the_operator_inserts_and_autonomy_bends(rig):
    make, robot, hands, _ = rig
    pilot = make("assist")
    robot.arm()
    hands.now = OperatorInput(STAMP, dead_man=True, insertion=0.3)
    sticks = pilot.read()
    assert sticks.insertion == 0.3 and sticks.bend_x > 0 > sticks.bend_y
    hands.now = OperatorInput(STAMP, dead_man=True)
    assert pilot.read().insertion == 0.0


def test_what_is_finished_ends_the_session_where_nobody_watches(rig):
    make = rig[0]
    for quits in (False, True):
        pilot = make(quits=quits)
        pilot.explorer.finished = True
        assert pilot.read().quit == quits


def test_a_place_is_known_once_it_was_sure_for_half_a_second(rig):
    robot = rig[1]
    seen = [Perception(0.0)]
    told = []
    with Autopilot(Hands(), robot, Wishing(), lambda robot: seen[0]) as pilot:
        for t_s, known, sd, age_s in (
            (1.0, False, 0.1, 0.0), (1.1, True, 0.1, 0.0), (1.5, True, 0.1, 0.0), (1.7, True, 0.1, 0.1),
            (1.8, True, 0.9, 0.0), (2.0, True, 0.2, 0.0), (2.4, True, 0.2, 0.7), (2.5, True, None, 0.0),
            (3.1, True, None, 0.0),
        ):  # fmt: skip
            seen[0] = Perception(t_s, np.eye(4) if known else None, t_s - age_s, position_sd_mm=sd)
            pilot.read()
            told.append(pilot.is_placed)
    assert told == [False, False, False, True, False, False, False, False, True]


def test_glare_is_the_share_of_white():
    image = np.zeros((40, 40), np.uint8)
    image[:, :20] = 255
    assert glare_share(image) == 0.5
    assert glare_share(np.stack([image, image, np.zeros_like(image)], axis=2)) == 0.0


def test_stones_and_when_the_place_was_seen_reach_the_explorer(rig, phantom, phantom_lumen, lens, vid):
    _, robot, hands, _ = rig
    stone = FoundStone(1, 0, np.zeros(3), np.eye(3), 4.0, 0.4, 9, 0.99, THERE, 0)
    frame = Frame(Stamp(7, 9.0, 9.0), np.zeros((8, 8), np.uint8))  # a pose of this picture was only expected
    state = NavigationState(frame=frame, seen_s=4.0, guidance=Guidance(stones=StoneList((stone,), ("",), (), False)))
    guide = SimpleNamespace(coverage=Coverage(phantom, lens, phantom_lumen, vid.T_kidney_camera), limits=ScopeLimits())
    navigator = SimpleNamespace(
        guide=guide, tracker=SimpleNamespace(lumen=phantom_lumen), vid=vid,
        bus=SimpleNamespace(latest=lambda: state), say_autonomy=lambda text, headed: None,
    )  # fmt: skip
    pilot = make_autopilot(navigator, hands, SimpleNamespace(robot=robot, clock=None), AutonomySettings(), False)
    told = []
    pilot.explorer.step = lambda seen, may: told.append((seen.stones, seen.seen_s)) or Wish()
    pilot.connect()
    pilot.read()
    assert told == [((stone,), 4.0)]
    assert pilot.explorer._steering.segment is robot.drive.segment, "it steers this robot's tip"


def test_who_looks_is_told_the_calyx_that_it_heads_for(rig, phantom, phantom_lumen, lens, vid):
    _, robot, hands, _ = rig
    guide = SimpleNamespace(coverage=Coverage(phantom, lens, phantom_lumen, vid.T_kidney_camera), limits=ScopeLimits())
    told = []
    navigator = SimpleNamespace(
        guide=guide, tracker=SimpleNamespace(lumen=phantom_lumen), vid=vid,
        bus=SimpleNamespace(latest=NavigationState), say_autonomy=lambda text, headed: told.append(headed),
    )  # fmt: skip
    pilot = make_autopilot(navigator, hands, SimpleNamespace(robot=robot, clock=None), AutonomySettings(), False)
    pilot.explorer.step = lambda seen, may: Wish()
    pilot.connect()
    for target in (-1, 3):
        pilot.explorer.target, pilot.explorer.machine.reason = target, f"to {target}"
        pilot.read()
    assert told == [-1, 3]
