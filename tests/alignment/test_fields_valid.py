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
