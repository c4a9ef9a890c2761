import numpy as np
import torch

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features.default import DefaultExtractor, DefaultSettings
from ursnav_torch.features.flatten import LocalPlane, flat_of, flatten, masked_blur
from ursnav_torch.features.shading import RimShading

LENS = equidistant_camera(160, 125, 125)
RAYS, INSIDE = LENS.pixel_rays()
MASK = torch.from_numpy(INSIDE).float()
AROUND = LocalPlane(MASK, 6.0)
SHADING = RimShading(LENS, MASK)


def wall() -> torch.Tensor:
    """Smooth structure, log units."""
    noise = torch.randn(125, 125, generator=torch.Generator().manual_seed(0))
    return masked_blur(noise, torch.ones(125, 125), 4.0) * 4 + 4


def beam(tilt_deg: float) -> torch.Tensor:
    """Log gain of a narrow beam that looks aside."""
    tilt = np.radians(tilt_deg)
    facing = RAYS @ np.array([np.sin(tilt), 0, np.cos(tilt)])
    return torch.from_numpy(6 * np.log(np.clip(np.nan_to_num(facing), 0.15, 1))).float() * MASK


def relief(log_image: torch.Tensor, corrected: bool) -> torch.Tensor:
    detail = AROUND.detail(log_image)
    if corrected:
        detail = detail - SHADING(detail)
    return flat_of(detail, AROUND.variance(detail), MASK)


def likeness(one: torch.Tensor, other: torch.Tensor) -> float:
    core = masked_blur(MASK, torch.ones_like(MASK), 2.0) > 0.99
    return float(torch.corrcoef(torch.stack([one[core], other[core]]))[0, 1])


def test_a_narrow_beam_straight_or_aside_leaves_less_of_itself() -> None:
    for tilt in (0, 10):
        seen = wall() + beam(tilt)
        plain, corrected = (likeness(relief(wall(), False), relief(seen, way)) for way in (False, True))
        assert 1 - corrected < 0.8 * (1 - plain), (tilt, plain, corrected)


def test_a_picture_without_a_beam_is_nearly_as_it_was() -> None:
    assert likeness(relief(wall(), False), relief(wall(), True)) > 0.98


def test_what_falls_off_ever_more_slowly_is_a_wall() -> None:
    """A hollow, as of a tube's walls, is left as it is; a bulge of the same size is not."""
    hollow, bulge = (SHADING(sign * AROUND.detail(beam(0))) for sign in (-1, 1))
    assert (hollow == 0).all() and bulge.abs().max() > 0.01


def test_the_middle_and_what_is_outside_the_lens_are_left_alone() -> None:
    far = np.hypot(*np.meshgrid(np.arange(125) - LENS.cx, np.arange(125) - LENS.cy))
    shading = SHADING(AROUND.detail(wall() + beam(10)))
    assert (shading[torch.from_numpy(far < 0.48 * 62)] == 0).all() and (shading[MASK == 0] == 0).all()
    assert shading.abs().max() > 0.01


def test_a_body_at_the_rim_is_no_beam() -> None:
    """A tenth of the fitted pixels far off moves the surface little: the regression is robust."""
    clean = AROUND.detail(wall() + beam(0))
    spoilt = clean.clone()
    spoilt[50:75, 100:120] += 3.0
    assert (SHADING(spoilt) - SHADING(clean)).abs().max() < 0.15


def test_a_lens_that_shows_too_little_is_not_corrected() -> None:
    slit = torch.zeros(125, 125)
    slit[60:65, 100:120] = 1
    assert (RimShading(LENS, slit)(wall()) == 0).all()


def test_a_real_picture_is_read_without_its_beam_and_a_drawn_view_as_it_is() -> None:
    extractor = DefaultExtractor(DefaultSettings(learned=0.0), LENS)

    def read(log_image: torch.Tensor, virtual: bool) -> torch.Tensor:
        gray = ((log_image.exp() * MASK).clamp(0, 255)).byte().numpy()
        return extractor.extract(gray, virtual, edges=False, bare=True).fields[0]

    smooth, dimmer = 0.4 * wall() + 3.2, beam(0) / 6  # bright enough to leave no rim black
    bare, seen, drawn = read(smooth, True), read(smooth + dimmer, False), read(smooth + dimmer, True)
    assert 1 - likeness(bare, seen) < 0.7 * (1 - likeness(bare, drawn))
    assert likeness(bare, read(smooth, False)) > 0.99


def test_uncorrected_is_what_flatten_gives() -> None:
    assert torch.equal(relief(wall(), False), flatten(wall(), MASK, AROUND))
