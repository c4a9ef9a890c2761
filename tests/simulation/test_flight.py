"""Flights of the twin: at the camera's rate, off the walls, and with odometry that errs as a cable drive's does."""

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import check_rigid
from ursnav_torch.simulation.flight import FlightSettings, fly
from ursnav_torch.simulation.twin import Scope

STEADY = FlightSettings(stops=0.0, roll_deg_s=0.0, tremor_mm=0.0, tremor_deg=0.0, pictures=40)


@pytest.fixture(scope="module")
def flight(phantom, phantom_lumen):
    return fly(phantom, phantom_lumen, (phantom.calyces[0].name,), STEADY, np.random.default_rng(0))


def test_pictures_come_at_the_cameras_rate_and_poses_are_rigid(flight):
    np.testing.assert_allclose(np.diff(flight.t_s), 0.1, atol=1 / 60 + 1e-9)
    for T in flight.T_kidney_camera:
        check_rigid(T, "T_kidney_camera")


def test_the_scope_goes_in_no_faster_than_it_is_flown_and_keeps_off_the_walls(flight, phantom_lumen):
    pushed = np.diff(flight.odometry[:, 0])
    assert pushed.max() <= STEADY.speed_mm_s * (0.1 + 1 / 60) + 1e-9
    assert flight.odometry[-1, 0] > 5
    assert phantom_lumen.clearance_mm(flight.T_kidney_camera[:, :3, 3]).min() > 0.5


def test_the_same_seed_gives_the_same_flight(flight, phantom, phantom_lumen):
    again = fly(phantom, phantom_lumen, (phantom.calyces[0].name,), STEADY, np.random.default_rng(0))
    np.testing.assert_array_equal(again.T_kidney_camera, flight.T_kidney_camera)


def test_a_slider_with_play_reports_more_than_the_tip_advances(flight, phantom, phantom_lumen):
    def ahead(flown):
        way = phantom_lumen.to_calyces(flown.T_kidney_camera[:, :3, 3])[:, 0]
        deepest = int(flown.odometry[:, 0].argmax())
        return flown.odometry[deepest, 0] - (way[0] - way[deepest])

    loose = Scope(backlash=(0.06, 0.06, 6.0))
    flown = fly(phantom, phantom_lumen, (phantom.calyces[0].name,), STEADY, np.random.default_rng(0), loose)
    assert ahead(flown) > ahead(flight) + 1.0


def test_speeds_of_nothing_are_refused():
    with pytest.raises(InputError, match="above 0"):
        FlightSettings(speed_mm_s=0.0)
    with pytest.raises(InputError, match=r"stops=1\.5"):
        FlightSettings(stops=1.5)
