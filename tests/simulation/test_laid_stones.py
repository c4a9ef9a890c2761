"""Simulated stones touch the wall, cross neither it nor one another, and stop the scope."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import Renderer
from ursnav_torch.simulation import World, make_twin
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


def test_a_simulated_scope_meets_its_stones_and_shows_them(
    phantom: Kidney, phantom_lumen: LumenDistance, renderer: Renderer
) -> None:
    world = World(phantom, renderer, phantom_lumen)
    stone = lay_stones(phantom, phantom_lumen, 1, np.random.default_rng([5, 2]))[0]
    away = phantom.centerline.points_mm - stone.center_mm
    before = phantom.centerline.points_mm[int(np.abs(np.linalg.norm(away, axis=1) - 7.0).argmin())]
    T = look_along(before, stone.center_mm - before)
    empty, holds = (make_twin(world, sensor="thesis_simulation", seed=5, stones=count) for count in (0, 1))
    assert holds._clearance(stone.center_mm[None])[0] < 0 < empty._clearance(stone.center_mm[None])[0]
    changed = np.abs(holds._render(T).astype(int) - empty._render(T)).max(axis=2)
    middle = tuple(slice(n // 2 - n // 16, n // 2 + n // 16) for n in changed.shape)
    assert changed[middle].mean() > 15 and changed[middle].mean() > 3 * changed.mean()


def test_stones_that_no_picture_would_show_are_refused(
    phantom: Kidney, phantom_lumen: LumenDistance, renderer: Renderer
) -> None:
    with pytest.raises(InputError, match="stones=2 need pictures"):
        make_twin(World(phantom, renderer, phantom_lumen), stones=2)
