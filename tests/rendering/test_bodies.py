"""Stones and instruments cover what is behind them, throw shadows and stay where they are; light bounces as it must."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.geometry import transform_from
from ursnav_torch.rendering import RaycastRenderer, View
from ursnav_torch.rendering.sensor import SensorFaults
from ursnav_torch.rendering.sensor.bodies import INSTRUMENT, STONE, WALL, BodyFaults, Stone
from ursnav_torch.rendering.sensor.bounce import bounced
from ursnav_torch.rendering.sensor.light import LightFaults
from ursnav_torch.rendering.sensor.presets import WIDE, draw_faults
from ursnav_torch.rendering.sensor.simulate import Labeled, simulate_labeled
from ursnav_torch.rendering.sensor.surface import surface_of

CAMERA: Camera = equidistant_camera(160, 120, 120)
RADIUS_MM = 10.0


@pytest.fixture(scope="module")
def ball() -> RaycastRenderer:
    """A hollow sphere around the origin."""
    return RaycastRenderer(trimesh.creation.icosphere(4, RADIUS_MM), CAMERA)


def white_stone(*center_mm: float, radius_mm: float = 1.0) -> Stone:
    return Stone(np.array(center_mm), np.full(3, radius_mm), np.eye(3), (1.0, 1.0, 1.0), 0.0, 0)


def drawn(ball: RaycastRenderer, T: np.ndarray, faults: SensorFaults, stones: list[Stone]) -> Labeled:
    return simulate_labeled(ball.render(T), CAMERA, T, faults, np.random.default_rng(0), stones)


def test_a_stone_covers_the_angle_that_its_size_and_distance_say(ball: RaycastRenderer) -> None:
    found = drawn(ball, np.eye(4), SensorFaults(), [white_stone(0, 0, 5)])
    rays, inside = CAMERA.pixel_rays()
    angle = np.arccos(np.clip(rays[..., 2], -1, 1))
    np.testing.assert_array_equal((found.kind == STONE)[inside], (angle < np.arcsin(1 / 5))[inside])
    assert (found.kind[inside & (angle > np.arcsin(1 / 5))] == WALL).all()


def test_a_stone_stays_where_it_is_while_the_camera_moves(ball: RaycastRenderer) -> None:
    """Its picture's middle is where its center projects to, from two places."""
    stone = white_stone(2, 1, 6)
    for T in (np.eye(4), transform_from(np.eye(3), np.array([1.0, -1.0, 2.0]))):
        found = drawn(ball, T, SensorFaults(), [stone])
        v, u = np.nonzero(found.kind == STONE)
        at = CAMERA.project(stone.center_mm - T[:3, 3])[0]
        np.testing.assert_allclose([u.mean(), v.mean()], at, atol=1.0)


def test_a_stone_behind_the_wall_is_not_seen(ball: RaycastRenderer) -> None:
    assert not (drawn(ball, np.eye(4), SensorFaults(), [white_stone(0, 0, 12)]).kind == STONE).any()


def test_a_stone_throws_a_shadow_on_the_side_away_from_the_lamp(ball: RaycastRenderer) -> None:
    faults = SensorFaults(light=LightFaults(offset_mm=2.0, angle_rad=0.0, ambient=0.0))  # the lamp at +x
    stone, clear = [white_stone(0, 0, 5)], []
    ratio = drawn(ball, np.eye(4), faults, stone).image.astype(float) / np.maximum(
        drawn(ball, np.eye(4), faults, clear).image.astype(float), 1
    )
    left, right = ratio[60, 45:50].mean(), ratio[60, 70:75].mean()
    assert left < 0.75 * right


def test_an_instrument_comes_from_its_side_and_ends_ahead(ball: RaycastRenderer) -> None:
    faults = SensorFaults(bodies=BodyFaults(instrument_mm=6.0, instrument_angle_rad=0.0, instrument_radius_mm=0.3))
    kind = drawn(ball, np.eye(4), faults, []).kind
    v, u = np.nonzero(kind == INSTRUMENT)
    assert u.min() > 58 and u.max() > 105 and np.abs(v - 59.5).max() < 15


def test_stones_are_placed_on_the_wall(ball: RaycastRenderer) -> None:
    faults = SensorFaults(bodies=BodyFaults(stones=3, stone_mm=1.5))
    T = np.eye(4)
    stones = simulate_labeled(ball.render(T), CAMERA, T, faults, np.random.default_rng(1)).stones
    assert len(stones) == 3
    for stone in stones:
        away = RADIUS_MM - np.linalg.norm(stone.center_mm)
        assert 0.4 * stone.radii_mm.min() < away < 1.2 * stone.radii_mm.max()


def test_light_bounces_in_a_sphere_as_theory_says(ball: RaycastRenderer) -> None:
    """Every point of a sphere of radius r sees a patch of area A with form factor A / (4 pi r^2)."""
    view: View = ball.render(np.eye(4))
    surface = surface_of(view, CAMERA, np.eye(4))
    n = len(surface.pixels)
    found = bounced(surface, surface.normals, np.full((n, 3), 0.6, np.float32), np.ones(n, np.float32))
    seen = (1 - np.cos(np.radians(80))) / 2
    np.testing.assert_allclose(np.median(found), 0.6 * seen, rtol=0.1)


def test_a_black_wall_sends_nothing_back(ball: RaycastRenderer) -> None:
    surface = surface_of(ball.render(np.eye(4)), CAMERA, np.eye(4))
    n = len(surface.pixels)
    assert not bounced(surface, surface.normals, np.zeros((n, 3), np.float32), np.ones(n, np.float32)).any()


def test_the_wide_preset_draws_pictures_of_every_kind_and_the_same_again(ball: RaycastRenderer) -> None:
    T = transform_from(np.eye(3), np.array([0.0, 0.0, -3.0]))
    kinds = set()
    for seed in range(12):
        faults = draw_faults(WIDE, np.random.default_rng(seed))
        one, two = (simulate_labeled(ball.render(T), CAMERA, T, faults, np.random.default_rng(seed)) for _ in "ab")
        np.testing.assert_array_equal(one.image, two.image)
        kinds |= set(np.unique(one.kind).tolist())
    assert kinds == {0, 1, 2, 3}


def test_no_bodies_changes_nothing(ball: RaycastRenderer) -> None:
    plain = drawn(ball, np.eye(4), SensorFaults(), [])
    beside = replace(SensorFaults(), bodies=BodyFaults(stone_mm=3.0, instrument_radius_mm=0.5))
    np.testing.assert_array_equal(drawn(ball, np.eye(4), beside, []).image, plain.image)
