import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.phantom.implicit import plan_surface
from ursnav_torch.kidney.phantom.plan import draw_plan
from ursnav_torch.kidney.phantom.shapes import Outline


@pytest.mark.parametrize("seed", [1, 3])
def test_a_phantom_is_one_closed_lumen_of_anatomical_size(seed: int) -> None:
    kidney = make_phantom_kidney(seed)
    mesh = kidney.mesh
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert 2_000 < mesh.volume < 15_000
    assert 40 < np.ptp(kidney.tips_mm[:, 2]) < 75
    assert 6 <= len(kidney.calyces) <= 14


def test_a_seed_gives_one_kidney_and_another_seed_another(phantom: Kidney) -> None:
    again = make_phantom_kidney(seed=0, calyces=6)
    np.testing.assert_array_equal(again.mesh.vertices, phantom.mesh.vertices)
    np.testing.assert_array_equal(again.tips_mm, phantom.tips_mm)
    other = make_phantom_kidney(seed=4, calyces=6)
    nearest = np.linalg.norm(other.tips_mm[:, None] - phantom.tips_mm, axis=-1).min(axis=1)
    assert np.median(nearest) > 2.0


def test_as_many_calyces_as_wanted_keep_apart() -> None:
    kidney = make_phantom_kidney(seed=2, calyces=12)
    assert len(kidney.calyces) == 12
    distance = np.linalg.norm(kidney.tips_mm[:, None] - kidney.tips_mm, axis=-1) + 99 * np.eye(12)
    assert distance.min() > 5.0


def test_tips_lie_just_off_the_wall_deep_in_their_calyx(phantom: Kidney) -> None:
    lumen = LumenDistance.from_kidney(phantom)
    clearance = lumen.clearance_mm(phantom.tips_mm)
    assert np.all((clearance > 0.6) & (clearance < 2.5))
    assert lumen.to_calyces(phantom.pelvis_mm).min() > 10


def test_a_papilla_stands_in_every_cup_with_a_fornix_around_it() -> None:
    rng = np.random.default_rng(5)
    plan = draw_plan(rng, 7)
    grid = LumenGrid.from_mesh(plan_surface(plan, rng), 0.4)
    for cup in plan.cups:
        local = cup.local(grid.centers_mm)
        inside = np.all(np.abs(local[:, :2]) < cup.radii_mm + 0.5, axis=1) & (np.abs(local[:, 2]) < cup.depth_mm + 2)
        off = np.min([np.linalg.norm(local[:, :2] - p.at_mm, axis=1) for p in cup.papillae], axis=0)
        over_papilla, around = (local[inside & where, 2].max() for where in (off < 0.6, off > 1.8))
        assert around > over_papilla + 0.3


def test_outlines_are_not_circles_but_keep_their_mean_radius() -> None:
    outline = Outline(np.array([0.2, 0.1]), np.array([0.3, 1.0]))
    radius = outline.at(np.linspace(0, 2 * np.pi, 360, endpoint=False))
    assert radius.mean() == pytest.approx(1.0) and np.ptp(radius) > 0.3
    plan = draw_plan(np.random.default_rng(0), 8)
    assert all(tube.outline.lobes[0] >= 0.05 for tube in plan.tubes)


def test_scale_enlarges_everything(phantom: Kidney) -> None:
    large = make_phantom_kidney(seed=0, calyces=6, scale=1.8)
    np.testing.assert_allclose(large.mesh.vertices, 1.8 * phantom.mesh.vertices)
    np.testing.assert_allclose(large.tips_mm, 1.8 * phantom.tips_mm)
    np.testing.assert_allclose(large.centerline.radius_mm, 1.8 * phantom.centerline.radius_mm)
    assert large.scale == 1.8


def test_superior_is_z(phantom: Kidney) -> None:
    heights = {pole: [c.tip_mm[2] for c in phantom.calyces if c.pole == pole] for pole in ("lower", "upper")}
    assert max(heights["lower"]) < min(heights["upper"])


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"calyces": 5}, "kidney.calyces must be a whole number from 6 to 14, got 5"),
        ({"calyces": 15}, "got 15"),
        ({"seed": -1}, "kidney.seed must be a whole number from 0 on, got -1"),
        ({"seed": 1.5}, "got 1.5"),
        ({"scale": 0.0}, r"kidney.scale must be a positive number, got 0.0"),
    ],
)
def test_values_out_of_range_are_refused(kwargs: dict[str, int], match: str) -> None:
    with pytest.raises(InputError, match=match):
        make_phantom_kidney(**kwargs)
