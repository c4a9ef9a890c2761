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
