"""Regions before the wall: their kind, place, size and probability, and what is too faint or too small to be told."""

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.features.foreground import SURE, find_bodies, large_stones, may_be_large
from ursnav_torch.features.network import WallReader
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import Stone, severity, simulate_labeled
from ursnav_torch.rendering.sensor.bodies import STONE

INSIDE = torch.ones(100, 100)


def disk(x: int, y: int, radius: int, probability: float) -> torch.Tensor:
    v, u = torch.meshgrid(torch.arange(100), torch.arange(100), indexing="ij")
    return torch.where((u - x) ** 2 + (v - y) ** 2 <= radius**2, probability, 0.0)


def test_a_stone_is_where_it_was_drawn_in_pixels_of_the_picture() -> None:
    (body,) = find_bodies(torch.stack([disk(30, 60, 8, 0.95), torch.zeros(100, 100)]), INSIDE, 2.0)
    assert body.kind == "stone" and body.probability == pytest.approx(0.95)
    assert body.center_px == pytest.approx((60.5, 120.5))
    assert body.size_px == pytest.approx(2 * 16, rel=0.05) and body.share == pytest.approx(0.0197, rel=0.05)
    assert body.mask.sum() == (disk(30, 60, 8, 1.0) > 0).sum()


def test_bodies_come_the_largest_first_each_of_its_likelier_kind() -> None:
    stone, wire = disk(20, 20, 5, SURE + 0.03), disk(70, 70, 10, 0.97)
    found = find_bodies(torch.stack([torch.maximum(stone, 0.9 * wire), wire]), INSIDE, 1.0)
    assert [body.kind for body in found] == ["instrument", "stone"]


@pytest.mark.parametrize(("radius", "probability"), [(8, SURE - 0.05), (2, 0.99)])
def test_what_is_faint_or_small_is_not_told(radius: int, probability: float) -> None:
    assert find_bodies(torch.stack([disk(50, 50, radius, probability), torch.zeros(100, 100)]), INSIDE, 1.0) == ()


def test_what_is_faint_is_not_told_beside_what_is_sure() -> None:
    stones = torch.maximum(disk(25, 25, 8, 0.97), disk(70, 70, 8, SURE - 0.05))
    (body,) = find_bodies(torch.stack([stones, torch.zeros(100, 100)]), INSIDE, 1.0)
    assert body.center_px == pytest.approx((25, 25), abs=0.6)


def test_nothing_is_told_outside_the_lens() -> None:
    outside = INSIDE.clone()
    outside[:, :50] = 0
    assert find_bodies(torch.stack([disk(25, 50, 12, 0.99), torch.zeros(100, 100)]), outside, 1.0) == ()


def test_a_large_stone_is_large_sure_throughout_and_convex() -> None:
    wide = disk(50, 50, 20, 0.95)
    assert torch.equal(large_stones(wide + disk(90, 90, 5, 0.99), INSIDE), wide), "the small one is for the other look"
    crescent = torch.where(disk(60, 50, 16, 1.0) > 0, 0.0, wide)
    half_sure = torch.where(disk(50, 50, 17, 1.0) > 0, 0.7, wide)
    for none in (crescent, half_sure, disk(50, 50, 9, 0.95)):
        assert not large_stones(none, INSIDE).any()
    assert not large_stones(wide, (disk(50, 50, 10, 1.0) > 0).float()).logical_and(disk(50, 50, 10, 1.0) == 0).any()


def test_a_large_stone_is_possible_where_as_much_as_one_covers_may_be_stone() -> None:
    faint, fainter, small = disk(50, 50, 14, 0.06), disk(50, 50, 14, 0.04), disk(50, 50, 11, 0.06)
    assert may_be_large(faint, INSIDE)
    assert not may_be_large(fainter, INSIDE) and not may_be_large(small, INSIDE)
    assert not may_be_large(faint, (disk(0, 0, 40, 1.0) > 0).float()), "outside the lens"
    assert may_be_large(small, (disk(50, 50, 40, 1.0) > 0).float()), "a share of the lens's picture, not of the array"


def test_a_second_look_is_for_pictures_that_a_stone_may_fill_alone(phantom, vid, monkeypatch) -> None:
    lens, rng, again = equidistant_camera(), np.random.default_rng(1), []
    renderer, extractor = RaycastRenderer(phantom.mesh, lens), DefaultExtractor(DefaultSettings(), lens, 0.0)
    look = WallReader.again
    monkeypatch.setattr(WallReader, "again", lambda self, image: again.append(image) or look(self, image))
    faults = severity("in_vivo_like", 0.2, rng)
    for T in vid.T_kidney_camera[::6]:
        extractor.extract(simulate_labeled(renderer.render(T), lens, T, faults, rng).image, edges=False, bare=True)
    assert len(again) <= 1


def test_a_stone_that_fills_a_fifth_of_the_picture_and_more_is_told_whole(phantom, vid) -> None:
    """Of most of these, the look at full size alone tells little or nothing."""
    lens, rng = equidistant_camera(), np.random.default_rng(0)
    renderer, extractor = RaycastRenderer(phantom.mesh, lens), DefaultExtractor(DefaultSettings(), lens, 0.0)
    faults, told, shown = severity("in_vivo_like", 0.2, rng), [], 0
    for T in vid.T_kidney_camera[::6]:
        away, radius = float(rng.uniform(4.2, 5.2)), 3.0
        center = T[:3, 3] + T[:3, :3] @ [*rng.uniform(-0.8, 0.8, 2), away]
        stone = Stone(center, np.full(3, radius), np.eye(3), (0.55, 0.75, 0.85), 0.1, 1)
        seen = simulate_labeled(renderer.render(T), lens, T, faults, rng, (stone,))
        truth = torch.from_numpy((seen.kind == STONE).astype(np.float32))[None, None]
        small = torch.nn.functional.interpolate(truth, extractor.lens_mask.shape, mode="area")[0, 0].numpy() > 0.5
        if small.sum() < 0.2 * float(extractor.lens_mask.sum()):
            continue
        bodies = [b for b in extractor.extract(seen.image, edges=False, bare=True).bodies if b.kind == "stone"]
        shown += 1
        told.append(max((float(b.mask[small].mean()) for b in bodies), default=0.0))
    assert shown >= 8 and sum(t >= 0.7 for t in told) >= 0.8 * shown, told


def test_a_stone_leaves_no_rim_in_the_relief_of_the_wall_that_a_track_reads_beside_it(lens, vid, monkeypatch) -> None:
    renderer, extractor = RaycastRenderer(vid.kidney.mesh, lens), DefaultExtractor(DefaultSettings(), lens, 0.0)
    height, width = extractor.lens_mask.shape
    v, u = np.mgrid[:height, :width] / height
    hidden = (u - 0.45) ** 2 + (v - 0.5) ** 2 < 0.2**2
    stone = torch.zeros(2, height, width)
    stone[0] = torch.from_numpy(hidden.astype(np.float32))
    there = cv2.resize(hidden.astype(np.uint8), (lens.width, lens.height)) > 0
    alike = []
    for T in vid.T_kidney_camera[28::7]:
        image = renderer.render(T).image
        monkeypatch.setattr(WallReader, "before", lambda self, image: torch.zeros_like(stone))
        plain = extractor.extract(image, edges=False, bare=True).fields[0]
        monkeypatch.setattr(WallReader, "before", lambda self, image: stone)
        found = extractor.extract(np.where(there, 250, image).astype(np.uint8), edges=False, bare=True)
        assert [body.kind for body in found.bodies] == ["stone"]
        compared = (found.valid > 0.5) & (extractor.lens_mask > 0)
        assert 0.6 < compared.sum() / extractor.lens_mask.sum() < 0.85
        alike.append(float(np.corrcoef(found.fields[0][compared], plain[compared])[0, 1]))
    assert np.median(alike) > 0.9, alike
