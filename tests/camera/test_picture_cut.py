"""Pictures of the calibrated camera that were cropped or scaled lie again where the lens has them."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ursnav_torch.camera import Camera, cut_of, equidistant_camera, mask_text, scaled_to

LENS = Camera("equidistant", 200, 160, 90.0, 89.0, 101.0, 78.5, (-0.02, 0.003, 0.0, 0.0))


@pytest.fixture
def smooth() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.asarray(cv2.GaussianBlur(rng.integers(0, 256, (160, 200, 3), np.uint8), (0, 0), 4))


def test_a_crop_that_was_scaled_is_put_back(smooth: np.ndarray) -> None:
    taken = LENS.cropped(20, 10, 150, 120).resized(300, 240)
    cut = cut_of(taken, LENS)
    assert cut is not None and (cut.x, cut.y, cut.w, cut.h) == (20, 10, 150, 120) and not cut.is_whole
    picture = cv2.resize(smooth[10:130, 20:170], (300, 240), interpolation=cv2.INTER_LINEAR)
    back = cut.put_back(picture)
    assert back.shape == smooth.shape and cut.inside().sum() == 150 * 120
    off = np.abs(back.astype(int) - smooth)[cut.inside()]
    assert off.max() <= 6 and not back[~cut.inside()].any()


def test_the_lens_itself_is_the_whole() -> None:
    cut = cut_of(LENS, LENS)
    assert cut is not None and cut.is_whole


@pytest.mark.parametrize(
    "other",
    [
        LENS.resized(250, 160),  # one picture, scaled unevenly: the whole still
        Camera("equidistant", 200, 160, 120.0, 119.0, 101.0, 78.5, LENS.k),
        Camera("equidistant", 200, 160, 90.0, 89.0, 81.0, 78.5, LENS.k),
        Camera("equidistant", 200, 160, 90.0, 89.0, 101.0, 78.5, (0.1, 0.003, 0.0, 0.0)),
        equidistant_camera(160, 200, 160),
    ],
    ids=["uneven", "longer", "off center", "other curve", "ideal"],
)
def test_another_lens_is_no_cut(other: Camera) -> None:
    cut = cut_of(other, LENS)
    if other.width == 250:
        assert cut is not None and cut.is_whole
    else:
        assert cut is None


@pytest.mark.parametrize("size", [(400, 320), (100, 80), (133, 106), (1920, 1536)])
def test_one_ratio_is_recognized_and_said(smooth: np.ndarray, size: tuple[int, int]) -> None:
    picture = cv2.resize(smooth, size, interpolation=cv2.INTER_AREA)
    with pytest.warns(UserWarning, match=rf"{size[0]} x {size[1]} px are taken for the lens's 200 x 160 px, scaled by"):
        back = scaled_to(picture, LENS)
    assert back.shape == smooth.shape
    assert np.abs(back.astype(int) - smooth).mean() < 2


@pytest.mark.parametrize("size", [(200, 160), (400, 300), (20, 16), (160, 200), (4000, 3200)])
def test_no_ratio_and_no_scale_leave_a_picture_as_it_is(size: tuple[int, int]) -> None:
    picture = np.zeros((size[1], size[0]), np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scaled_to(picture, LENS) is picture


@pytest.mark.parametrize("scaled", [False, True])
def test_a_lens_with_a_mask_or_a_circle_of_its_own_shows_less(scaled: bool) -> None:
    mask = np.zeros((160, 200), bool)
    mask[40:120, 50:150] = True
    taken = replace(LENS, mask=mask_text(mask))
    cut = cut_of(taken.resized(400, 320) if scaled else taken, LENS)
    assert cut is not None and cut.is_whole and cut.narrows
    plain = cut_of(LENS.resized(400, 320) if scaled else LENS, LENS)
    assert plain is not None and plain.numbers() != cut.numbers(), "what was located otherwise is not taken up"
    assert (cut.inside() != mask).sum() < 0.02 * mask.sum()
    ideal = equidistant_camera(160, 200, 160)
    narrow = cut_of(replace(ideal, fov_deg=100), ideal)
    assert narrow is not None and narrow.narrows
    np.testing.assert_array_equal(narrow.inside(), replace(ideal, fov_deg=100).pixel_rays()[1])
    same, wider = cut_of(taken, taken), cut_of(LENS, taken)
    assert same is not None and wider is not None and not same.narrows and not wider.narrows
