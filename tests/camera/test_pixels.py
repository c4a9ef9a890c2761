"""`Camera.pixels` is `Camera.project` for who asks many times."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.camera import Camera, equidistant_camera, pinhole_camera

FISHEYE = equidistant_camera(140.0, 200, 160)


@pytest.mark.parametrize("lens", [FISHEYE, replace(FISHEYE, k=(0.02, -0.01, 0.003, -0.0005)), pinhole_camera()])
def test_pixels_are_where_points_are_projected_to(lens: Camera) -> None:
    points = np.random.default_rng(0).normal(0, 3, (3, 4, 50)).astype(np.float32)
    points[2] = np.abs(points[2]) + 1.0
    points[:2, 0, 0] = 0.0  # on the axis
    expected, _ = lens.project(points.transpose(1, 2, 0))
    np.testing.assert_allclose(lens.pixels(points), expected.transpose(2, 0, 1), atol=2e-3)
