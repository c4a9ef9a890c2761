"""Teaching the wall network: the same seed gives the same weights, from new ones or from those of a file."""

from pathlib import Path

import pytest
import torch

from benchmarks.wall_network import stored, write_weights
from benchmarks.wall_network.targets import Batch
from benchmarks.wall_network.train import BATCH, train, validate
from ursnav_torch.features.network import CELL, FOREGROUND, WallNetwork, packaged_network

SIZE = 32


@pytest.fixture(scope="module")
def lessons() -> Batch:
    """Slopes under a light that falls off with depth: something that can be learned."""
    generator = torch.Generator().manual_seed(0)
    slope = torch.rand(BATCH, 1, 1, generator=generator) * torch.linspace(-1, 1, SIZE)[None, None]
    slope = slope.expand(BATCH, SIZE, SIZE)
    picture = (120 + 100 * slope).to(torch.uint8)[:, None].repeat(1, 3, 1, 1)
    rays = torch.zeros(BATCH, 3, SIZE, SIZE, dtype=torch.float16)
    rays[:, 2] = 1
    rest = torch.zeros(BATCH, 2 + len(FOREGROUND), SIZE // CELL, SIZE // CELL, dtype=torch.float16)
    rest[:, 1] = 1
    return Batch(picture, rays, slope.half(), rest)


def taught(lessons: Batch, rate: float, start: WallNetwork | None = None, batches: int = 4) -> WallNetwork:
    torch.manual_seed(3)
    threads = torch.get_num_threads()
    try:
        return train(start or WallNetwork(), lessons, lessons, batches * BATCH, rate, seed=1, threads=1)
    finally:
        torch.set_num_threads(threads)


def test_the_same_seed_gives_the_same_weights(lessons: Batch) -> None:
    one, another = (taught(lessons, 1e-3).state_dict() for _ in range(2))
    assert all(torch.equal(one[name], another[name]) for name in one)


def test_it_learns_by_its_weights(lessons: Batch) -> None:
    """More than by the means and variances of its layers, which follow the pictures at any rate."""
    resting, learned = (validate(taught(lessons, rate, batches=60), lessons)["relief"] for rate in (0.0, 3e-3))
    assert learned < resting - 0.1


def test_it_goes_on_from_the_weights_of_a_file(lessons: Batch, tmp_path: Path) -> None:
    write_weights(taught(lessons, 1e-3), tmp_path / "weights.safetensors")
    start = stored(tmp_path / "weights.safetensors")
    kept = {name: value.clone() for name, value in start.state_dict().items()}
    gone_on = taught(lessons, 1e-9, start).state_dict()
    weights = [name for name in kept if name.endswith("weight")]
    assert weights and all(torch.allclose(gone_on[name], kept[name], atol=1e-3) for name in weights)


def test_the_packages_own_weights_read_as_the_package_does(lessons: Batch) -> None:
    picture, rays = lessons.picture[:2].float(), lessons.rays[:2].float()
    with torch.inference_mode():
        own, packaged = stored()(picture, rays), packaged_network()(picture, rays)
    torch.testing.assert_close(own.relief, packaged.relief, atol=1e-3, rtol=1e-3)
