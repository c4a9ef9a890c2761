"""What lies between the threads, and the path."""

import threading
from dataclasses import replace

import numpy as np

from ursnav_torch.navigation import Newest, StateBus, Trail


def test_the_newest_item_wins_and_is_taken_once():
    place = Newest()
    for i in range(5):
        place.put(i)
    assert place.take(0.0) == 4 and place.take(0.0) is None
    assert place.replaced == 4


def test_an_observer_that_never_looks_costs_nothing():
    bus = StateBus()
    for i in range(1000):
        bus.update(lambda state, i=i: replace(state, calyx=str(i)))
    assert bus.latest().calyx == "999" and bus.latest().version == 1000


def test_waiting_for_a_newer_state():
    bus = StateBus()
    assert bus.wait(0, 0.01) is None
    timer = threading.Timer(0.05, lambda: bus.update(lambda state: replace(state, calyx="C")))
    timer.start()
    found = bus.wait(0, 5.0)
    timer.join()
    assert found is not None and found.calyx == "C"


def test_concurrent_updates_lose_nothing():
    bus = StateBus()

    def count():
        for _ in range(300):
            bus.update(lambda state: replace(state, effort=state.effort + 1))

    threads = [threading.Thread(target=count) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert bus.latest().effort == bus.latest().version == 1200


def test_the_path_stays_within_bounds_and_keeps_its_ends():
    trail = Trail(step_mm=0.5, most=64)
    for i in range(2000):
        trail.add(np.array([0.3 * i, 0.0, 0.0]))
        before = trail.points()
    assert 30 < len(trail.points()) <= 64
    assert trail.points()[0, 0] == 0 and trail.points()[-1, 0] > 0.97 * 0.3 * 1999
    assert (np.diff(trail.points()[:, 0]) > 0).all()
    kept = before.copy()
    for i in range(200):
        trail.add(np.array([0.0, 9.0 * i, 0.0]))
    assert (kept == before).all()
