"""A way in: how far it got, how long it may stand still, and whether the tip follows the shaft."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import later

from ursnav_torch.autonomy import AutonomySettings, Perception
from ursnav_torch.autonomy.resistance import Push

AXIS = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(("follows", "resists"), [(1.0, False), (0.5, False), (0.0, True)])
@pytest.mark.parametrize("unit_mm", [1.0, 2.0])
def test_a_tip_that_makes_less_of_the_way_than_its_shaft_meets_resistance(follows, resists, unit_mm) -> None:
    settings = AutonomySettings()
    push, seen = Push(replace(settings, resistance_mm=unit_mm), unit_mm), Perception(0.0, np.eye(4), slack_mm=0.0)
    push.cycle(seen)
    push.begin(seen, np.zeros(3), 0.0)
    met = []
    for n in range(1, 60):
        seen = later(seen, 0.05, insertion_mm=0.1 * unit_mm * n)
        push.cycle(seen)
        push.see(seen, AXIS * follows * seen.insertion_mm)
        met.append(push.resists(AXIS))
    assert any(met) is resists


def test_a_way_that_gets_nowhere_has_failed_after_the_patience_there_is_and_getting_on_renews_it() -> None:
    push, seen = Push(AutonomySettings(patience_s=2.0), 1.0), Perception(0.0, np.eye(4))
    push.cycle(seen)
    push.begin(seen, np.zeros(3), 5.0)
    assert push.gets_on(5.2, 1.9) and not push.gets_on(5.2, 2.1), "too little to count"
    assert push.gets_on(5.5, 2.2) and push.best_mm == 5.5
    assert push.gets_on(5.0, 4.1) and not push.gets_on(5.0, 4.3)


@pytest.mark.parametrize("dt_s", [1 / 30, 1 / 7.5])
def test_resistance_is_met_as_soon_at_any_rate_of_the_camera(dt_s) -> None:
    push, seen = Push(AutonomySettings(resistance_mm=0.7), 1.0), Perception(0.0, np.eye(4), slack_mm=0.0)
    push.cycle(seen)
    push.begin(seen, np.zeros(3), 0.0)
    while not push.resists(AXIS):
        seen = later(seen, dt_s, insertion_mm=seen.insertion_mm + 1.0 * dt_s)
        push.cycle(seen)
        push.see(seen, np.zeros(3))
    assert seen.insertion_mm == pytest.approx(0.7 + 0.23, abs=0.15)


@pytest.mark.parametrize(("pulled", "slack_mm"), [(True, 1.2), (False, 0.0)])
def test_only_a_slider_that_was_pulled_has_its_play_before_it(pulled, slack_mm) -> None:
    """A way in that begins anew while it stands has none."""
    push = Push(AutonomySettings(), 1.0)
    seen = Perception(0.0, np.eye(4), slack_mm=1.2, insertion_mm=9.0 if not pulled else 11.0)
    push.cycle(seen)
    push.cycle(seen := later(seen, 0.1, insertion_mm=10.0))
    push.cycle(seen := later(seen, 0.1))  # it stands
    push.begin(seen, np.zeros(3), 0.0)
    while not push.resists(AXIS):
        push.cycle(seen := later(seen, 0.02, insertion_mm=seen.insertion_mm + 0.01))
        push.see(seen, np.zeros(3))
    assert seen.insertion_mm - 10.0 == pytest.approx(slack_mm + 0.7 + 0.5 * 0.23, abs=0.06)
