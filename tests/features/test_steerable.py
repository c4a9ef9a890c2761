"""Steerable components: a roll is a phase with the scan's own sign, and what is kept is what has most energy."""

import torch

from ursnav_torch.features.steerable import learn_basis

SECTORS = 72


def some_maps(count: int, seed: int = 0) -> torch.Tensor:
    """Maps (N, 3, 4, 72) of a few waves around the axis."""
    generator = torch.Generator().manual_seed(seed)
    angle = torch.arange(SECTORS) / SECTORS * 2 * torch.pi
    waves = torch.cat([torch.cos(k * angle)[None] for k in range(6)] + [torch.sin(k * angle)[None] for k in range(6)])
    return torch.randn(count, 3, 4, 12, generator=generator) @ waves


def test_all_components_give_the_correlation_at_every_roll() -> None:
    """The picture rolled by s sectors sees at a what the view sees at a + s."""
    maps, query = some_maps(9), some_maps(1, seed=1)[0]
    basis = learn_basis(maps, 10_000)
    found = basis.turned(query, SECTORS) @ basis.table(maps)
    for s in range(SECTORS):
        expected = (query * torch.roll(maps, -s, -1)).sum((1, 2, 3))
        torch.testing.assert_close(found[s], expected, rtol=1e-3, atol=2e-2)


def test_a_rolled_picture_is_found_at_its_roll() -> None:
    maps = some_maps(9)
    basis = learn_basis(maps, 40)
    rolled = torch.roll(maps[4], -20, -1)
    scores = basis.turned(rolled, SECTORS // 2) @ basis.table(maps)
    assert divmod(int(scores.argmax()), 9) == (10, 4)


def test_what_is_kept_has_the_most_energy() -> None:
    """Of maps made of two components, two are enough, and the first alone is the stronger one."""
    angle = torch.arange(SECTORS) / SECTORS * 2 * torch.pi
    strong, weak = torch.zeros(1, 2, 3, SECTORS), torch.zeros(1, 2, 3, SECTORS)
    strong[0, 0, 1], weak[0, 1, 2] = torch.cos(2 * angle), torch.cos(5 * angle)
    generator = torch.Generator().manual_seed(0)
    a, b = torch.randn(2, 50, 1, 1, 1, generator=generator)
    maps = 3 * a * strong + b * weak
    whole = maps.square().sum()
    two, one = learn_basis(maps, 2), learn_basis(maps, 1)
    assert two.frequency.tolist() == [2, 5] and one.frequency.tolist() == [2]
    torch.testing.assert_close(two.table(maps).square().sum(), whole, rtol=1e-4, atol=0)
    torch.testing.assert_close(one.table(maps).square().sum(), (3 * a * strong).square().sum(), rtol=1e-4, atol=0)
    torch.testing.assert_close(learn_basis(maps, 2, most=10).table(maps).square().sum(), whole, rtol=1e-4, atol=0)
