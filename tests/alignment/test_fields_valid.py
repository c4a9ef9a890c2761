"""What of a picture is compared: its valid part, within the lens."""

from dataclasses import replace

import numpy as np
import torch

from ursnav_torch.alignment.fields import AlignGrid
from ursnav_torch.features import DefaultSettings
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid


def test_what_is_not_wall_has_no_weight(vid: Vid, renderer: RaycastRenderer) -> None:
    grid = AlignGrid(vid.camera, 40, DefaultSettings())
    features = vid.extractor().extract(renderer.render(vid.T_kidney_camera[3]).image, virtual=True)
    whole = grid.of_picture(features)
    valid = torch.ones_like(features.fields[0])
    valid[:, : valid.shape[1] // 2] = 0
    half = grid.of_picture(replace(features, valid=valid))
    np.testing.assert_array_equal(whole.weight, grid.compared.astype(np.float32))
    assert half.weight[:, :18].max() == 0
    np.testing.assert_allclose(half.weight[:, 23:], whole.weight[:, 23:], atol=1e-5)
    np.testing.assert_array_equal(half.value, whole.value)


def test_a_picture_is_shrunk_as_torch_does_with_antialiasing(vid: Vid, renderer: RaycastRenderer) -> None:
    grid = AlignGrid(vid.camera, 40, DefaultSettings())
    planes = torch.rand(3, 125, 125, generator=torch.Generator().manual_seed(0))
    expected = torch.nn.functional.interpolate(planes[None], (40, 40), mode="bilinear", antialias=True)[0]
    np.testing.assert_allclose(grid.small(planes), expected.numpy(), atol=1e-6)


def test_one_picture_after_the_other_is_read_anew(vid: Vid, renderer: RaycastRenderer) -> None:
    grid, extractor = AlignGrid(vid.camera, 40, DefaultSettings()), vid.extractor()
    here, there = (extractor.extract(renderer.render(vid.T_kidney_camera[view]).image, virtual=True) for view in (3, 9))
    first, second = grid.of_picture(here), grid.of_picture(there)
    assert grid.of_picture(there) is second
    assert np.abs(first.value - second.value).max() > 0.1
    np.testing.assert_array_equal(grid.of_picture(here).value, first.value)


def test_slopes_and_values_are_sampled_where_they_are(vid: Vid, renderer: RaycastRenderer) -> None:
    """In the order slopes in x, slopes in y, values; at whole pixels nothing is interpolated."""
    grid = AlignGrid(vid.camera, 40, DefaultSettings())
    fields = grid.of_picture(vid.extractor().extract(renderer.render(vid.T_kidney_camera[3]).image, virtual=True))
    y, x = np.array([[12, 20, 30], [25, 18, 9]])
    out = np.empty((1, 9, 3), np.float32)
    weight = grid.sample(fields, np.stack([x, y])[:, None].astype(np.float32), out)
    planes = np.concatenate([fields.slope_x, fields.slope_y, fields.value])
    np.testing.assert_allclose(out[0], planes[:, y, x], atol=1e-6)
    np.testing.assert_array_equal(weight[0], fields.weight[y, x])
