"""An explorer in the small phantom, and what it may be told."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.autonomy import Explorer, Perception, Permission
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.geometry import look_along

HELD = Permission(held=True, armed=True)


@pytest.fixture
def explorer(phantom, phantom_lumen, lens, vid):
    return Explorer(Coverage(phantom, lens, phantom_lumen, vid.T_kidney_camera[::2]), phantom_lumen)


@pytest.fixture
def at_root(phantom):
    """In the pelvis, in sight of the calyces, 10 mm in."""
    start = phantom.centerline.points_mm[0]
    T = look_along(start, phantom.tips_mm.mean(axis=0) - start)
    return Perception(0.0, T, 0.0, bend_rad=np.array([0.1, -0.1]), insertion_mm=10.0)


def later(seen: Perception, seconds: float, **changes) -> Perception:
    """The same some time later, by a new picture."""
    return replace(seen, t_s=seen.t_s + seconds, seen_s=seen.t_s + seconds, **changes)
