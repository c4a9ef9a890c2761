"""Regions before the wall: their kind, place, size and probability, and what is too faint or too small to be told."""

import pytest
import torch

from ursnav_torch.features.foreground import SURE, find_bodies

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
