"""Points on dark rims: where they are, which way they run, and that a VID of them is one like others."""

from pathlib import Path

import numpy as np
import pytest
import torch

from ursnav_torch.camera import Camera
from ursnav_torch.features import (
    DefaultSettings,
    RimExtractor,
    RimSettings,
    make_extractor,
    relief_extractor,
    settings_from_dict,
    settings_to_dict,
)
from ursnav_torch.features.rims import dark_rims
from ursnav_torch.kidney import Kidney
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import default_matching
from ursnav_torch.vid import PlanSettings, build_vid, load_vid

WHOLE = torch.ones(80, 90)


def line(degrees: float, through: tuple[float, float] = (43.0, 38.0), width: float = 1.5) -> torch.Tensor:
    """A dark line (80, 90) of a bright relief through a place x, y, at an angle x towards y."""
    y, x = torch.meshgrid(torch.arange(80.0), torch.arange(90.0), indexing="ij")
    return 1 - torch.exp(-0.5 * (beside(x, y, degrees, through) / width) ** 2)


def beside(x: torch.Tensor, y: torch.Tensor, degrees: float, through: tuple[float, float]) -> torch.Tensor:
    """Signed distance of places from that line, px."""
    angle = np.radians(degrees)
    return (y - through[1]) * float(np.cos(angle)) - (x - through[0]) * float(np.sin(angle))


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 90.0, 130.0])
def test_convention_rims_lie_on_a_dark_line_and_run_along_it(degrees: float) -> None:
    strength, across = dark_rims(line(degrees), WHOLE, 1.2)
    y, x = (strength > 0.2 * strength.max()).nonzero().T
    assert len(x) > 50
    assert beside(x.float(), y.float(), degrees, (43.0, 38.0)).abs().max() < 1
    along = torch.atan2(across[1], across[0])[y, x] + torch.pi / 2
    off = torch.rad2deg(torch.arcsin(torch.sin(along - np.radians(degrees)).abs()))
    within = (x >= 5) & (x < 85) & (y >= 5) & (y < 75)
    assert off[within].max() < 3


def test_a_bright_line_is_no_rim() -> None:
    strength, _ = dark_rims(-line(20.0), WHOLE, 1.2)
    y, x = torch.meshgrid(torch.arange(80.0), torch.arange(90.0), indexing="ij")
    dark, _ = dark_rims(line(20.0), WHOLE, 1.2)
    assert strength[beside(x, y, 20.0, (43.0, 38.0)).abs() < 1].max() < 0.1 * dark.max()


def test_strength_is_the_curvature_across() -> None:
    """A valley of curvature 0.3 everywhere along one row: blurring a parabola does not change it."""
    y = torch.arange(80.0)[:, None] - 40
    strength, _ = dark_rims((0.15 * y**2).expand(80, 90).contiguous(), WHOLE, 1.2)
    torch.testing.assert_close(strength[30:50, 20:70].amax(0), torch.full((50,), 0.3), rtol=1e-3, atol=1e-3)


def test_nothing_outside_the_mask_nor_along_its_border() -> None:
    y, x = torch.meshgrid(torch.arange(80.0), torch.arange(90.0), indexing="ij")
    mask = (torch.hypot(x - 44.5, y - 39.5) < 30).float()
    strength, _ = dark_rims((line(20.0) + 5) * mask, mask, 1.2)
    assert not strength[mask == 0].any()
    y, x = (strength > 0.2 * strength.max()).nonzero().T
    assert len(x) > 30 and beside(x.float(), y.float(), 20.0, (43.0, 38.0)).abs().max() < 1


def test_a_flat_relief_has_no_rims() -> None:
    assert not dark_rims(WHOLE * 0, WHOLE, 1.2)[0].any()
    assert dark_rims(WHOLE * 2, WHOLE, 1.2)[0].max() < 1e-5


def test_points_of_a_picture_lie_on_its_dark_line(lens: Camera) -> None:
    """In px of the whole picture, where the reduced one is another."""
    large = lens.resized(250, 250)
    v, u = np.mgrid[:250, :250]
    distance = (v - 131.0) * np.cos(0.4) - (u - 120.0) * np.sin(0.4)
    image = (150 - 110 * np.exp(-0.5 * (distance / 3) ** 2)).round().astype(np.uint8)
    image[~large.pixel_rays()[1]] = 0
    edges = make_extractor(RimSettings(), large).extract(image, virtual=True).edges
    x, y = edges.points.double().numpy().T
    off = np.abs((y - 131.0) * np.cos(0.4) - (x - 120.0) * np.sin(0.4))
    sure = edges.weight.numpy() > 0.5
    assert sure.sum() > 30 and np.median(off[sure]) < 1 and np.quantile(off[sure], 0.9) < 2
    turn = np.abs(np.sin(edges.direction.numpy()[sure] - 0.4))
    assert np.degrees(np.arcsin(np.median(turn))) < 4


def test_a_kind_of_its_own_with_the_maps_of_the_default(picture: np.ndarray, lens: Camera) -> None:
    rims, default = (make_extractor(s, lens).extract(picture, virtual=True) for s in (RimSettings(), DefaultSettings()))
    assert torch.equal(rims.maps, default.maps) and torch.equal(rims.fields, default.fields)
    assert not torch.equal(rims.edges.points, default.edges.points)
    data = settings_to_dict(RimSettings(points=50))
    assert data["kind"] == "rims" and settings_from_dict(data) == RimSettings(points=50) != DefaultSettings(points=50)
    assert settings_to_dict(DefaultSettings())["kind"] == "default"
    assert Localizer.settings_line(RimSettings()) != Localizer.settings_line(DefaultSettings())


def test_a_part_of_the_lens_and_another_share_of_the_network_keep_the_rims(lens: Camera) -> None:
    extractor = relief_extractor(RimSettings(), lens, 0.0)
    assert isinstance(extractor, RimExtractor)
    scene = np.ones((lens.height, lens.width), bool)
    scene[:, :30] = False
    assert isinstance(extractor.through(scene), RimExtractor)
    assert type(relief_extractor(DefaultSettings(), lens)) is type(make_extractor(DefaultSettings(), lens))


def test_a_vid_of_rims_is_opened_again_and_locates_its_own_picture(
    phantom: Kidney, lens: Camera, tmp_path: Path
) -> None:
    plan = PlanSettings(views_per_calyx=4, passage_views=2)
    build_vid(phantom, lens, RimSettings(), RaycastRenderer, plan, tmp_path / "vid", workers=1)
    vid = load_vid(tmp_path / "vid")
    assert vid.settings == RimSettings() and isinstance(vid.extractor(), RimExtractor)
    localizer = Localizer(vid, default_matching(both_sides=True), LocalizationSettings(refine=False))
    found = localizer.locate(vid.read_picture(5))
    assert found.calyx == vid.calyx[5]
    np.testing.assert_allclose(found.T_kidney_camera, vid.T_kidney_camera[5], atol=0.2)
