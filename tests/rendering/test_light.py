"""The headlight: inverse-square fall-off, slant, exposure."""

import numpy as np
import pytest

from ursnav_torch.rendering import HeadLight

#: Walls that face the camera, this far ahead.
AHEAD = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 4.0], [0.0, 0.0, 8.0]])
FACING = np.tile([0.0, 0.0, -1.0], (3, 1))
#: Linear, the brightest at half: what is compared is radiance.
LINEAR = {"gamma": 1.0, "exposure_percentile": 100.0, "exposure_level": 0.5}


def test_light_falls_off_with_the_square_of_the_distance_and_the_lights_own_extent() -> None:
    for reach in (0.001, 4.0):
        gray = HeadLight(reach_mm=reach, **LINEAR).shade(AHEAD, FACING)
        expected = (2.0**2 + reach**2) / (AHEAD[:, 2] ** 2 + reach**2)
        np.testing.assert_allclose(gray, 0.5 * expected, rtol=1e-6)


def test_a_slanted_wall_is_darker_by_the_cosine_and_ambient_fills_what_is_turned_away() -> None:
    slanted = np.array([[0.0, 0.0, -1.0], [0.0, np.sin(1.0), -np.cos(1.0)], [0.0, 0.0, 1.0]])
    gray = HeadLight(ambient=0.1, **LINEAR).shade(np.tile(AHEAD[1], (3, 1)), slanted)
    np.testing.assert_allclose(gray / gray[0], [1.0, (np.cos(1.0) + 0.1) / 1.1, 0.1 / 1.1], rtol=1e-6)


def test_a_light_beside_the_lens_shifts_what_is_bright() -> None:
    aside = np.array([[-3.0, 0.0, 5.0], [3.0, 0.0, 5.0]])
    left, right = HeadLight(offset_mm=(2.0, 0.0, 0.0), **LINEAR).shade(aside, FACING[:2])
    assert right == pytest.approx(0.5) and left < 0.6 * right
