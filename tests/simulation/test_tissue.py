"""Breath, swelling, bleeding and buckling: each from a seed, each by itself."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.devices import Drive, Joints
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.simulation import (
    CALM,
    Scope,
    SimulatedTime,
    Tissue,
    TissueSettings,
    Twin,
    World,
    draw_tissue,
    make_twin,
)
from ursnav_torch.simulation.stones import ObstructedLumen, distance_to_stone, lay_stones
from ursnav_torch.simulation.world import operated_twin, swelling_renderer

FLAGS = ("breathes", "swells", "bleeds", "buckles")
TIMES = np.arange(0.0, 300.0, 0.1)


def only(flag: str) -> TissueSettings:
    return replace(CALM, **{flag: True})


def effects(tissue: Tissue) -> dict[str, bool]:
    return {
        "breathes": any(tissue.breath_mm(t).any() for t in TIMES[:100]),
        "swells": tissue.swollen_mm(60.0) > 0,
        "bleeds": any(tissue.blood(t) > 0 for t in TIMES),
        "buckles": tissue.friction > 0,
    }


@pytest.mark.parametrize("flag", FLAGS)
def test_each_is_switched_on_by_itself(flag: str) -> None:
    assert effects(draw_tissue(only(flag), 3)) == {name: name == flag for name in FLAGS}
    assert not any(effects(draw_tissue(None, 3)).values())


def test_a_seed_draws_the_same_operation_and_another_another() -> None:
    def told(seed: int) -> list[float]:
        tissue = draw_tissue(TissueSettings(), seed)
        return [*tissue.breath_mm(1.3), tissue.swollen_mm(40.0), *(tissue.blood(t) for t in TIMES), tissue.friction]

    assert told(5) == told(5) != told(6)


def test_convention_the_surface_moves_by_4_plus_minus_2_mm_and_the_scope_does_not_follow_a_part() -> None:
    settings = replace(only("breathes"), slips=(1.0, 1.0), breaths_per_min=(15.0, 15.0))
    ways = []
    for seed in range(200):
        tissue = draw_tissue(settings, seed)
        places = np.array([tissue.breath_mm(t) for t in np.arange(0, 4.0, 0.05)])
        ways.append(float(np.linalg.norm(np.ptp(places, axis=0))))
        np.testing.assert_allclose(tissue.breath_mm(0.7), tissue.breath_mm(4.7), atol=1e-9)  # 15 a minute
    assert np.mean(ways) == pytest.approx(4.0, abs=0.4) and np.std(ways) == pytest.approx(2.0, abs=0.3)
    less = [np.linalg.norm(draw_tissue(only("breathes"), s).breath_mm(0.0)) for s in range(50)]
    assert np.mean(less) < 0.5 * np.mean(ways) / 2


def test_irrigation_fills_a_kidney_and_a_larger_one_by_more() -> None:
    small, large = draw_tissue(only("swells"), 1), draw_tissue(only("swells"), 1, scale=1.8)
    filled = [small.swollen_mm(t) for t in (0.0, 10.0, 60.0, 1000.0)]
    assert filled[0] == 0.0 and filled == sorted(filled) and 0.2 <= filled[-1] <= 1.5
    assert large.swollen_mm(60.0) == pytest.approx(1.8 * small.swollen_mm(60.0))
    walls = small.clearance(lambda points: np.ones(len(points)), lambda: 60.0)
    np.testing.assert_allclose(walls(np.zeros((2, 3))), 1.0 + filled[2])


def test_a_bleeding_comes_at_once_is_washed_out_and_takes_light() -> None:
    settings = replace(only("bleeds"), bleedings_per_min=(1.0, 1.0), bleeding_peak=(0.8, 0.8), bleeding_s=(9.0, 9.0))
    tissue = draw_tissue(settings, 0)
    share = np.array([tissue.blood(t) for t in TIMES])
    assert 0.7 < share.max() <= 0.8 and 0.02 < (share > 0.05).mean() < 0.5
    peak = int(share.argmax())
    rises = np.flatnonzero(share[:peak] == 0)[-1]
    washed = peak + int(np.argmax(share[peak:] < 0.1 * share.max()))
    assert TIMES[peak] - TIMES[rises] < 2.0 < 4.0 < TIMES[washed] - TIMES[peak]
    image = np.full((8, 8, 3), 200, np.uint8)
    bloody = tissue.picture(image, float(TIMES[peak]))
    blue, green, red = bloody[0, 0].tolist()
    assert red > 1.3 * blue and red > 1.3 * green and red < 130
    np.testing.assert_array_equal(tissue.picture(image, 0.0), image)
    assert tissue.picture(image[..., 0], float(TIMES[peak])).max() < 100


def test_an_operation_bleeds_as_often_as_it_is_told_to() -> None:
    settings = replace(only("bleeds"), bleedings_per_min=(0.5, 0.5))
    counts = [int((draw_tissue(settings, seed)._begins_s < 3600).sum()) for seed in range(40)]
    assert np.mean(counts) == pytest.approx(30.0, abs=3.0)


def pushed(scope: Scope) -> tuple[Twin, list[float]]:
    """A bent scope in the open, pushed by 10 mm and pulled back by 10; its insertion on the way."""
    drive, now = Drive(), [np.zeros(3)]
    twin = Twin(lambda p: np.full(len(p), 9.0), lambda T: np.zeros((1, 1), np.uint8), np.eye(4), scope)
    twin.drive_with(lambda: now[0])
    told = []
    for mm in [*np.arange(0.0, 10.1, 0.5), *np.arange(10.0, -0.1, -0.5)]:
        now[0] = drive.axes_mm(Joints(bend_x_rad=1.0, insertion_mm=float(mm)))
        twin.pose()
        told.append(twin.insertion_mm)
    return twin, told


def test_a_bent_shaft_buckles_as_it_is_pushed_and_is_straightened_first_as_it_is_pulled() -> None:
    rigid = Scope(backlash=(0.0, 0.0, 0.0))
    _, straight = pushed(rigid)
    twin, bent = pushed(replace(rigid, friction=0.4))
    assert max(straight) == pytest.approx(10.0) and max(bent) == pytest.approx(10.0 * np.exp(-0.4), abs=0.1)
    top = len(np.arange(0.0, 10.1, 0.5))
    assert bent[top + 5] == pytest.approx(max(bent)), "2.5 mm of pull only straighten it"
    assert bent[-1] == pytest.approx(0.0, abs=1e-6) and twin.loop_mm == pytest.approx(0.0, abs=1e-6)
    limited, far = pushed(replace(rigid, friction=0.4, loop_mm=1.0))
    assert max(far) == pytest.approx(9.0, abs=0.05) and limited.loop_mm < 1e-6


def test_a_twin_is_what_its_tissue_says(vid, renderer) -> None:
    clock = SimulatedTime()
    world = World(vid.kidney, renderer, vid.lumen, lambda mesh: RaycastRenderer(mesh, vid.camera), clock)
    start = transform_from(np.eye(3), vid.kidney.centerline.points_mm[0])
    tissue = draw_tissue(replace(TissueSettings(), swelling_mm=(1.0, 1.0), swelling_s=(5.0, 5.0)), 2)
    twin = operated_twin(world, start, Scope(), tissue)
    calm = operated_twin(world, start, Scope(), draw_tissue(None, 2))
    assert twin.scope.friction == tissue.friction > 0 == calm.scope.friction
    clock.now_s = 60.0
    assert not np.allclose(twin.pose(), start) and np.allclose(calm.pose(), start)
    room = twin._clearance(start[None, :3, 3]) - calm._clearance(start[None, :3, 3])
    assert room[0] == pytest.approx(tissue.swollen_mm(60.0))
    drawn = swelling_renderer(world, tissue, clock)
    assert drawn() is drawn() is not renderer
    wider, rest = drawn().render(start).depth_mm, renderer.render(start).depth_mm
    seen = np.isfinite(wider) & np.isfinite(rest)
    assert np.median(wider[seen] - rest[seen]) > 0.5


def test_the_twin_of_a_printed_kidney_swells_by_as_much_more(vid, renderer) -> None:
    clock, at, gained = SimulatedTime(), vid.kidney.centerline.points_mm[:1], []
    for scale in (1.0, 2.0):
        world = World(replace(vid.kidney, scale=scale), renderer, vid.lumen, clock=clock)
        twin = make_twin(world, tissue=only("swells"))
        clock.now_s += 600.0
        gained.append(twin._clearance(at) - vid.lumen.clearance_mm(at))
    assert gained[1] == pytest.approx(2 * gained[0]) and gained[0] > 0.1


def test_stones_do_not_give_way_to_irrigation(vid, renderer) -> None:
    clock = SimulatedTime()
    stone = lay_stones(vid.kidney, vid.lumen, 1, np.random.default_rng(3))[0]
    world = World(vid.kidney, renderer, ObstructedLumen(vid.lumen, (stone,)), clock=clock)
    start = transform_from(np.eye(3), vid.kidney.centerline.points_mm[0])
    tissue = draw_tissue(replace(only("swells"), swelling_mm=(1.0, 1.0), swelling_s=(5.0, 5.0)), 2)
    twin = operated_twin(world, start, Scope(), tissue)
    clock.now_s = 60.0
    points = np.stack([stone.center_mm, start[:3, 3]])
    walls = vid.lumen.clearance_mm(points) + tissue.swollen_mm(60.0)
    assert distance_to_stone(stone, points[:1])[0] == pytest.approx(-stone.radii_mm.min())
    np.testing.assert_allclose(twin._clearance(points), np.minimum(walls, distance_to_stone(stone, points)))
    np.testing.assert_allclose(twin._clearance(points), [-stone.radii_mm.min(), walls[1]])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"slips": (0.5, 0.1)}, "go from low to high"),
        ({"friction": (-0.1, 0.1)}, "begin at 0 or more"),
        ({"breaths_per_min": (0.0, 1.0)}, "above 0"),
        ({"bleeding_peak": (0.1, 1.5)}, "bleeding_peak up to 1"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(changes, says) -> None:
    with pytest.raises(InputError, match=says):
        TissueSettings(**changes)
    with pytest.raises(InputError, match="friction and loop_mm >= 0"):
        Scope(friction=-1.0)
