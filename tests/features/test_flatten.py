import numpy as np
import torch

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features.flatten import LocalPlane, blur, flatten, masked_blur, remove_stripes

LENS = equidistant_camera(160, 125, 125)
MASK = torch.from_numpy(LENS.pixel_rays()[1]).float()


AROUND = LocalPlane(MASK, 6.0)


def wall() -> torch.Tensor:
    """Smooth structure, log units."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(125, 125, generator=generator)
    return masked_blur(noise, torch.ones(125, 125), 4.0) * 4 + 4


def test_blurring_does_not_drag_the_outside_in() -> None:
    flat = torch.full((125, 125), 3.0) * MASK + 1e6 * (1 - MASK)
    inside = masked_blur(flat, MASK, 3.0)[MASK > 0]
    torch.testing.assert_close(inside, torch.full_like(inside, 3.0), rtol=1e-4, atol=1e-4)


def test_a_masks_own_blur_made_once_changes_no_bit() -> None:
    both = blur(torch.stack([wall() * MASK, MASK]), 3.0)
    assert torch.equal(masked_blur(wall(), MASK, 3.0), both[0] / both[1].clamp_min(1e-3))


def test_relief_does_not_know_the_exposure_or_the_vignette() -> None:
    """A factor on the light is a constant in the logarithm; a vignette is nearly one within the surroundings."""
    v, u = torch.meshgrid(torch.arange(125.0), torch.arange(125.0), indexing="ij")
    vignette = -1.5 * ((u - 62) ** 2 + (v - 62) ** 2) / 62**2
    relief = flatten(wall(), MASK, AROUND)
    torch.testing.assert_close(flatten(wall() + 0.7, MASK, AROUND), relief, rtol=1e-3, atol=1e-3)
    core = masked_blur(MASK, torch.ones_like(MASK), 3.0) > 0.999
    both = torch.stack([relief[core], flatten(wall() + vignette, MASK, AROUND)[core]])
    assert torch.corrcoef(both)[0, 1] > 0.98
    assert (relief[MASK == 0] == 0).all() and relief.abs().max() <= 3


def test_surroundings_of_a_slope_are_the_slope_itself_even_at_the_rim() -> None:
    """A mean of the surroundings is off by a whole slope there: the light's fall-off would look like relief."""
    v, u = torch.meshgrid(torch.arange(125.0), torch.arange(125.0), indexing="ij")
    slope = 3 + 0.05 * u - 0.08 * v
    off = ((AROUND(slope) - slope) * MASK).abs().max()
    assert off < 0.02 < 0.2 < ((masked_blur(slope, MASK, 6.0) - slope) * MASK).abs().max()


def test_plane_is_that_of_least_squares_also_beside_a_hole_and_in_single_precision() -> None:
    """The closed form against numpy's solver, at pixels in the middle, at the hole's edge and at the rim."""
    v, u = torch.meshgrid(torch.arange(125), torch.arange(125), indexing="ij")
    mask, image = MASK * ((u - 70) ** 2 + (v - 60) ** 2 > 25**2), wall()
    planes = {dtype: LocalPlane(mask, 6.0, dtype)(image) for dtype in (torch.float64, torch.float32)}
    v, u, seen = v.numpy(), u.numpy(), mask.numpy()
    for x, y in ((30, 60), (44, 60), (70, 34), (6, 62)):
        reach = (abs(u - x) <= 18) & (abs(v - y) <= 18)  # the blur's: three of its widths
        weight = np.sqrt(np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 6.0**2)) * seen * reach).ravel()
        columns = np.stack([np.ones(125 * 125), (u - x).ravel(), (v - y).ravel()], 1)
        solved = np.linalg.lstsq(columns * weight[:, None], image.numpy().ravel() * weight, rcond=None)[0]
        for plane in planes.values():
            assert abs(float(plane[y, x]) - solved[0]) < 0.01
    torch.testing.assert_close(planes[torch.float32], planes[torch.float64], rtol=0, atol=1e-4)
    assert (planes[torch.float32][mask == 0] == 0).all()


def test_beam_of_the_light_leaves_the_relief_alone_up_to_the_rim() -> None:
    beam = torch.from_numpy(np.log(np.clip(LENS.pixel_rays()[0][..., 2], 0.05, 1))).float()
    rim = (MASK > 0) & (masked_blur(MASK, torch.ones_like(MASK), 4.0) < 0.98)
    both = torch.stack([flatten(wall(), MASK, AROUND)[rim], flatten(wall() + 0.5 * beam, MASK, AROUND)[rim]])
    assert torch.corrcoef(both)[0, 1] > 0.97


def test_one_stripe_pattern_is_taken_out_and_nothing_else() -> None:
    stripes = 0.25 * torch.sin(1.3 * torch.arange(125.0))[:, None]
    clean = wall()
    left = (remove_stripes(clean + stripes, MASK) - clean) * MASK
    assert left.abs().max() < 0.25 * stripes.abs().max()
    torch.testing.assert_close(remove_stripes(clean, MASK), clean)


def test_stripes_at_any_frequency_leave_finite_values() -> None:
    for frequency in np.linspace(0.09, 0.5, 7):
        striped = wall() + 0.3 * torch.cos(2 * torch.pi * float(frequency) * torch.arange(125.0))[:, None]
        assert torch.isfinite(remove_stripes(striped, MASK)).all()
