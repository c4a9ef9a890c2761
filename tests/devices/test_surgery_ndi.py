"""scikit-surgerynditracker, unchanged, against the simulated unit: a second implementation of the host's side."""

import pytest
from clocks import does_not_hang

from ursnav_torch.devices import NdiTracker, SurgeryNdiTracker
from ursnav_torch.devices.trackers import surgery_ndi as room
from ursnav_torch.errors import DeviceNotConnectedError, DeviceTimeoutError, MissingExtraError
from ursnav_torch.simulation.ndi_unit import NdiUnit
from ursnav_torch.simulation.port import SimulatedPort

POSE = ((10.0, 20.0, -300.5), (0.0, 0.6, 0.0, 0.8))


@pytest.fixture
def unit():
    unit = NdiUnit(lambda: POSE)
    unit.port = SimulatedPort(unit, period_s=0.002)
    yield unit
    unit.port.close()


def test_both_drivers_read_the_same_pose(unit):
    pytest.importorskip("sksurgerynditracker", reason="needs the extra ndi")
    settings = {"tracker type": "aurora", "serial port": unit.port.path}
    with SurgeryNdiTracker(settings) as tracker:
        theirs = tracker.read()
        later = tracker.read()
        unit.answering = False
        with does_not_hang(), pytest.raises(DeviceTimeoutError):  # while the package itself waits for seconds
            while True:
                tracker.read(timeout_s=0.2)
        unit.answering = True
    with NdiTracker(unit.port.path, dof=6) as tracker:
        ours = tracker.read()
    assert theirs.position_mm == ours.position_mm
    assert theirs.axis == pytest.approx(ours.axis)
    assert theirs.quaternion_xyzw == pytest.approx(ours.quaternion_xyzw)
    assert later.source_frame > theirs.source_frame


def test_a_tracker_that_is_not_there_gives_the_packages_reason():
    pytest.importorskip("sksurgerynditracker", reason="needs the extra ndi")
    with pytest.raises(DeviceNotConnectedError, match="scikit-surgerynditracker ended"):
        SurgeryNdiTracker({"tracker type": "aurora", "serial port": "/dev/no-such-port"}).connect()


def test_without_the_extra_the_message_names_it(monkeypatch):
    def absent(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr("importlib.import_module", absent)
    with pytest.raises(MissingExtraError, match=r"ursnav-torch\[ndi\]"):
        room.SurgeryNdiTracker({}).connect()
