"""A place that was lost is found again by the operator's thumb while the session runs and reads on."""

import time

import pytest
from dialogue import wait_until

from benchmarks.safety.bench import KINDS, Bench
from ursnav_torch.devices import Gamepad, Limits, Note, OperatorInput
from ursnav_torch.session import Control


class Thumb(Gamepad):
    """Presses once what it is told to."""

    def __init__(self):
        super().__init__()
        self.presses = {}

    def read(self):
        pressed, self.presses = self.presses, {}
        return OperatorInput(self._stamp(), **pressed)

    def _open(self): ...

    def _close(self): ...


@pytest.mark.parametrize("kind", KINDS)
def test_acknowledged_twice_a_lost_place_is_known_again(kind, monkeypatch):
    monkeypatch.setattr("ursnav_torch.session.control.CONFIRM_AFTER_S", 0.1)
    with Bench(kind, Limits(max_insertion_mm=6.0)) as bench:
        robot, thumb = bench.robot, Thumb()
        control = Control(robot, thumb)
        robot.arm()
        bench.drive(8.0, 0.3)
        robot.stop()
        assert bench.come_to_rest()
        bench.reset()

        told = []

        def cycles(count, **presses):
            thumb.presses = presses
            for _ in range(count):
                told.extend(event for event in control.step() if isinstance(event, Note) and event.level != "info")
                time.sleep(0.02)

        assert wait_until(lambda: cycles(5) or robot.gate.state == "stopped")
        cycles(30, acknowledge=True)
        assert robot.gate.state == "disarmed" and not robot.place.is_known
        cycles(10, arm=True)
        assert robot.gate.state == "disarmed"
        cycles(10, acknowledge=True)
        assert robot.place.is_known
        assert "acknowledge once more" in told[-2].text and "confirmed" in told[-1].text  # pages keep the last
        cycles(10, arm=True)
        assert robot.gate.state == "armed" and robot.read().place_known
