"""The wall network: shapes for any size, one function before and after folding, and what it must be able to do."""

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.camera import Camera, equidistant_camera, pinhole_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.features.default import blend
from ursnav_torch.features.network import (
    CELL,
    FOREGROUND,
    WallNetwork,
    WallReader,
    fold,
    hues,
    lens_rays,
    packaged_network,
    read_wall,
)
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor.bodies import INSTRUMENT, STONE, BodyFaults
from ursnav_torch.rendering.sensor.simulate import SensorFaults, simulate_labeled
from ursnav_torch.rendering.sensor.wall import WallFaults
from ursnav_torch.vid import Vid


@pytest.mark.parametrize(("width", "height"), [(128, 128), (125, 125), (140, 97), (33, 32)])
def test_pictures_of_any_size_are_read(width: int, height: int) -> None:
    picture, rays = torch.rand(2, 3, height, width) * 255, torch.rand(2, 3, height, width)
    found = read_wall(picture, rays)
    assert found.relief.shape[0] == 2 and found.relief.shape[1] >= height and found.relief.shape[2] >= width
    assert found.odds.shape[1] == len(FOREGROUND) and found.odds.shape[2] == found.relief.shape[1] // CELL
    assert torch.isfinite(found.relief).all()


def test_no_pictures_give_no_readings() -> None:
    assert WallNetwork().eval()(torch.zeros(0, 3, 32, 32), torch.zeros(0, 3, 32, 32)).relief.shape == (0, 32, 32)


def test_folding_batch_norms_changes_nothing() -> None:
    torch.manual_seed(3)
    network = WallNetwork()
    x = torch.rand(4, 3, 64, 64) * 255, torch.rand(4, 3, 64, 64)
    network(*x)  # batch norms learn something
    before = network.eval()(*x)
    after = fold(network.requires_grad_(False))(*x)
    torch.testing.assert_close(after.relief, before.relief, atol=1e-4, rtol=1e-3)
    torch.testing.assert_close(after.odds, before.odds, atol=1e-4, rtol=1e-3)


def test_the_packaged_network_is_as_small_as_promised() -> None:
    assert sum(p.numel() for p in WallNetwork().parameters()) <= 300_000
    assert not packaged_network().training and packaged_network() is packaged_network()


@pytest.mark.parametrize("lens", [equidistant_camera(160.0, 250, 250), pinhole_camera(80.0, 320, 240)])
def test_rays_are_zero_outside_the_lens(lens: Camera) -> None:
    rays = lens_rays(lens)
    assert rays.shape == (3, lens.height, lens.width)
    assert float(rays[:2][:, rays[2] == 0].abs().sum()) == 0
    assert rays[0, lens.height // 2, -lens.width // 4] > 0 > rays[0, lens.height // 2, lens.width // 4]


def test_gray_and_equal_color_pictures_read_alike() -> None:
    lens = equidistant_camera(160.0, 125, 125)
    reader = WallReader(lens, torch.ones(125, 125))
    gray = np.random.default_rng(0).integers(30, 200, (250, 250), dtype=np.uint8)
    one, three = reader.read(gray), reader.read(np.repeat(gray[..., None], 3, 2))
    torch.testing.assert_close(one[0], three[0])
    assert one[0].shape == (5, 125, 125) and one[1].shape == (2, 125, 125)
    torch.testing.assert_close(reader.before(gray), one[1])


def test_a_plain_view_reads_as_its_own_relief(vid: Vid, phantom: Kidney) -> None:
    """What the network is there for: the drawn view's relief, from a picture under another light and skin."""
    renderer = RaycastRenderer(phantom.mesh, vid.camera)
    drawn = DefaultExtractor(DefaultSettings(learned=1.0), vid.camera)
    alike = []
    for T in vid.T_kidney_camera[::7]:
        image = renderer.render(T).image
        truth, read = (drawn.extract(image, virtual=virtual).fields[0] for virtual in (True, False))
        alike.append(float(torch.corrcoef(torch.stack([truth.flatten(), read.flatten()]))[0, 1]))
    assert np.median(alike) > 0.7


def test_a_stone_is_not_wall(vid: Vid, phantom: Kidney) -> None:
    """Where a stone lies the picture is not valid, elsewhere it is."""
    renderer, rng = RaycastRenderer(phantom.mesh, vid.camera), np.random.default_rng(5)
    extractor = DefaultExtractor(DefaultSettings(), vid.camera)
    on, off = [], []
    for T in vid.T_kidney_camera[::5]:
        seen = simulate_labeled(renderer.render(T), vid.camera, T, SensorFaults(bodies=BodyFaults(stones=1)), rng)
        valid = extractor.extract(seen.image, edges=False).valid
        if not valid.numel():
            continue
        size = (valid.shape[1], valid.shape[0])
        stone = cv2.resize((seen.kind == STONE).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        if not 0.02 < stone.mean() < 0.4:
            continue
        on.append(float(valid[torch.from_numpy(stone > 0.9)].mean()))
        off.append(float(valid[torch.from_numpy(stone == 0) & (valid > 0)].mean()))
    assert len(on) >= 3 and np.median(on) < 0.5 and np.median(off) > 0.85


def test_what_lies_before_the_wall_has_no_edges(vid: Vid, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stone over the picture's left part, as the network tells it: no edge point is left there."""
    extractor, image = DefaultExtractor(DefaultSettings(), vid.camera), vid.read_picture(0)
    assert extractor._network is not None
    read, before = extractor._network.read(image)
    stone = torch.zeros_like(before)
    middle = before.shape[2] // 2
    stone[0, :, :middle] = 1.0

    def found(told: torch.Tensor) -> torch.Tensor:
        monkeypatch.setattr(extractor._network, "read", lambda _: (read, told))
        return extractor.extract(image).edges.points[:, 0] * before.shape[2] / vid.camera.width

    free = found(torch.zeros_like(before))
    assert float(free.min()) < middle - 2 and float(found(stone).min()) > middle - 2


def test_hues_are_those_of_the_picture_left_out_whatever_the_light() -> None:
    picture = torch.full((1, 3, 8, 8), 4.0)
    picture[0, 2] += 0.7  # a red wall
    picture[0, 0, :2, :2] += 1.0  # a blue corner
    light = torch.linspace(-2, 2, 64).view(1, 1, 8, 8)
    inside = torch.ones(1, 8, 8)
    found = hues(picture + light, inside)
    torch.testing.assert_close(found[0, 0, :2, :2], torch.full((2, 2), 2.0), atol=1e-5, rtol=0)
    assert float(found[0, :, 2:, 2:].abs().max()) < 1e-4 and float(found[0, 2, :2, :2].min()) == 5.0
    inside[:, :, :4] = 0
    assert float(hues(picture, inside)[..., :4].abs().max()) == 0 and torch.isfinite(hues(picture, 0 * inside)).all()


def test_gray_pictures_have_no_hues() -> None:
    gray = torch.rand(2, 1, 8, 8).expand(2, 3, 8, 8)
    assert float(hues(gray, torch.ones(2, 8, 8)).abs().max()) == 0


@pytest.mark.parametrize(("wall", "fiber"), [((0.4, 0.45, 0.9), (0.9, 0.4, 0.1)), ((0.3, 0.8, 0.4), (0.8, 0.2, 0.9))])
def test_a_fiber_of_another_color_than_the_wall_is_told(
    vid: Vid, phantom: Kidney, wall: tuple[float, float, float], fiber: tuple[float, float, float]
) -> None:
    """Blue on red, and colors that nobody has seen in a kidney."""
    renderer, rng = RaycastRenderer(phantom.mesh, vid.camera), np.random.default_rng(6)
    extractor = DefaultExtractor(DefaultSettings(), vid.camera)
    bodies = BodyFaults(instrument_mm=8.0, instrument_radius_mm=0.35, instrument_lean=0.2, instrument_bgr=fiber)
    faults, told, seen = SensorFaults(wall=WallFaults(color_bgr=wall), bodies=bodies), 0, 0
    for T in vid.T_kidney_camera[::5]:
        drawn = simulate_labeled(renderer.render(T), vid.camera, T, faults, rng)
        if (drawn.kind == INSTRUMENT).mean() > 0.02:
            seen += 1
            told += any(b.kind == "instrument" for b in extractor.extract(drawn.image, edges=False).bodies)
    assert seen >= 8 and told >= 0.75 * seen


def test_drawn_views_and_photometric_relief_ask_no_network(vid: Vid, phantom: Kidney) -> None:
    image = RaycastRenderer(phantom.mesh, vid.camera).render(vid.T_kidney_camera[3]).image
    learned, plain = (DefaultExtractor(DefaultSettings(learned=share), vid.camera) for share in (0.3, 0.0))
    torch.testing.assert_close(learned.extract(image, virtual=True).fields, plain.extract(image).fields)
    assert not plain.extract(image).valid.numel()
    assert not torch.equal(learned.extract(image).fields, plain.extract(image).fields)


def test_a_blend_has_the_contrast_of_the_first_and_its_shares() -> None:
    mask = torch.ones(8, 8)
    mask[:, :2] = 0
    first, second = torch.randn(8, 8), 0.1 * torch.randn(8, 8)
    torch.testing.assert_close(blend(first, second, mask, 0.0), first)
    only = blend(first, second, mask, 1.0)
    assert float((only * mask).norm()) == pytest.approx(float((first * mask).norm()), rel=1e-5)
    torch.testing.assert_close(blend(first, second, mask, 0.3), 0.7 * first + 0.3 * only)


@pytest.mark.parametrize("share", [-0.1, 1.2])
def test_a_share_beyond_0_to_1_is_refused(share: float) -> None:
    with pytest.raises(InputError, match=rf"learned={share} must lie in 0\.\.1"):
        DefaultSettings(learned=share)
