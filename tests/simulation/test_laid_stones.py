"""Simulated stones touch the wall, cross neither it nor one another, and stop the scope."""

import numpy as np
from scipy.spatial.transform import Rotation

from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.simulation.stones import ObstructedLumen, distance_to_stone, lay_stones


def test_stones_touch_the_wall_and_cross_nothing(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    stones = lay_stones(phantom, phantom_lumen, 4, np.random.default_rng(2))
    assert len(stones) == 4
    directions = Rotation.random(2000, rng=1).apply([0.0, 0.0, 1.0])
    for stone in stones:
        rim = stone.center_mm + (directions * stone.radii_mm) @ stone.R_kidney_stone.T
        assert -0.1 < phantom_lumen.clearance_mm(rim).min() < 0.1
        assert 2.0 <= 2 * stone.radii_mm.max() <= 8.0
        assert all(distance_to_stone(other, rim).min() > 0 for other in stones if other is not stone)


def test_a_stone_is_in_the_scopes_way(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    stones = lay_stones(phantom, phantom_lumen, 1, np.random.default_rng(3))
    room = ObstructedLumen(phantom_lumen, stones)
    assert room.clearance_mm(stones[0].center_mm)[0] < 0 < phantom_lumen.clearance_mm(stones[0].center_mm)[0]
    far = phantom.pelvis_mm
    assert room.clearance_mm(far) == phantom_lumen.clearance_mm(far)
