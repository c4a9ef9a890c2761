"""The picture on its frame, whatever its shape, and the parts of it that no corner came to."""

import cv2
import numpy as np
import pytest

from ursnav_torch.calibration.field import field_coverage, picture_mask


def frames(shape: np.ndarray, seed: int = 0, floor: int = 4) -> list[np.ndarray]:
    """Three noisy pictures of a board-like pattern that is lit within ``shape`` alone."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(3):
        pattern = np.kron(rng.integers(0, 2, (12, 16)), np.full((20, 20), 200)) + 20
        made.append(np.where(shape, pattern, floor).astype(np.uint8))
    return made


def shapes() -> dict[str, np.ndarray]:
    v, u = np.indices((240, 320))
    circle = np.hypot(u - 170, v - 115) < 100
    return {
        "circle": circle,
        "circle cut above and below": circle & (abs(v - 115) < 70),
        "square with cut corners": (abs(u - 160) < 100) & (abs(v - 120) < 100) & (abs(u - 160) + abs(v - 120) < 170),
    }


@pytest.mark.parametrize("name", shapes())
def test_the_mask_is_where_the_picture_is(name: str) -> None:
    shape = shapes()[name]
    mask = picture_mask(frames(shape))
    assert mask is not None and np.mean(mask != shape) < 0.01


def test_a_picture_that_fills_its_frame_has_no_mask() -> None:
    assert picture_mask(frames(np.ones((240, 320), bool))) is None


def test_writing_beside_the_picture_is_no_picture() -> None:
    shape = shapes()["circle"]
    made = frames(shape)
    for picture in made:
        cv2.putText(picture, "12:03", (5, 230), cv2.FONT_HERSHEY_PLAIN, 1.0, 255)
    mask = picture_mask(made)
    assert mask is not None and np.mean(mask != shape) < 0.01


def test_black_pictures_have_no_mask() -> None:
    assert picture_mask([np.zeros((240, 320), np.uint8)]) is None


def test_parts_without_a_corner_are_named_the_way_one_looks_at_the_picture() -> None:
    shape = shapes()["circle"]
    v, u = np.nonzero(shape)
    every = np.column_stack([u, v]).astype(float)
    assert field_coverage(every, shape).empty == () and field_coverage(every, shape).share == 1.0
    left_only = every[every[:, 0] < 140]
    found = field_coverage(left_only, shape)
    assert "the rim at the right" in found.empty and "half-way to the lower right" in found.empty
    assert not any(word.endswith(" left") for word in found.empty)
    upper = field_coverage(every[every[:, 1] < 115], shape)
    assert "the rim at the bottom" in upper.empty and "the rim at the top" not in upper.empty
    middle = field_coverage(every[np.hypot(*(every - [170, 115]).T) < 30], shape)
    assert middle.share == pytest.approx(1 / 17) and "the middle" not in middle.empty
    rim = field_coverage(every[np.hypot(*(every - [170, 115]).T) > 75], shape)
    assert rim.empty[0] == "the middle" and not any(word.startswith("the rim") for word in rim.empty)
