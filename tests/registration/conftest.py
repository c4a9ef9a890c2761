"""A drive through the small phantom with a 5-DoF sensor on the tip."""

import pytest

from benchmarks.shared.em import Drive, drive_through
from ursnav_torch.kidney import Kidney


@pytest.fixture(scope="session")
def drive(phantom: Kidney) -> Drive:
    return drive_through(phantom, range(len(phantom.calyces)))
