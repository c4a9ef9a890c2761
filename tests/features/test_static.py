"""What never changes in a source's pictures: text, a narrower mask; not a dark calyx, not a scope at rest."""

import cv2
import numpy as np
import pytest

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultExtractor, DefaultSettings, StillPixels, scene_of

LENS = equidistant_camera(160.0, 250, 250)
INSIDE = LENS.pixel_rays()[1]


def pictures(count: int = 16, dark: bool = True) -> list[np.ndarray]:
    """Smooth scenes that change, with a middle that is always dark, as a JPEG leaves them."""
    rng, found = np.random.default_rng(4), []
    y, x = np.mgrid[:250, :250]
    for _ in range(count):
        scene = cv2.resize(
            rng.uniform(40, 230, (8, 8, 3)).astype(np.float32), (250, 250), interpolation=cv2.INTER_CUBIC
        )
        if dark:
            scene[np.hypot(x - 125, y - 120) < 28] = 6
        scene[~INSIDE] = 0
        coded = cv2.imencode(".jpg", scene.clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        found.append(cv2.imdecode(coded, cv2.IMREAD_COLOR))
    return found


def test_burnt_in_text_is_found_and_a_dark_calyx_is_not() -> None:
    shown = pictures()
    for image in shown:
        cv2.putText(image, "PATIENT 17", (60, 205), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 3)
    scene = scene_of(shown, INSIDE)
    assert scene is not None
    text = np.zeros((250, 250, 3), np.uint8)
    cv2.putText(text, "PATIENT 17", (60, 205), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 3)
    on = (text[..., 0] > 250) & INSIDE
    assert (~scene[on]).mean() > 0.9, "the text is no scene"
    assert scene[110:130, 115:135].all(), "the dark middle is"
    assert (INSIDE & ~scene).mean() < 0.15


def test_a_narrower_mask_is_found() -> None:
    shown = pictures()
    for image in shown:
        image[:, :60] = 2
    scene = scene_of(shown, INSIDE)
    assert scene is not None and not scene[:, :58].any() and (scene | ~INSIDE)[:, 75:].mean() > 0.97


@pytest.mark.parametrize("dark", [True, False])
def test_the_lens_own_mask_is_nothing_new(dark: bool) -> None:
    assert scene_of(pictures(dark=dark), INSIDE) is None


def test_few_pictures_or_a_scope_at_rest_tell_nothing() -> None:
    assert scene_of(pictures(11), INSIDE) is None and scene_of([], INSIDE) is None
    assert scene_of(pictures(1) * 30, INSIDE) is None


def test_a_scope_that_hardly_moves_tells_nothing() -> None:
    """Part of the picture has changed, part of it a little, and part not at all: nothing is burnt in."""
    still, moved = pictures(2)
    share = np.linspace(0, 3, 250).clip(max=1)[None, :, None]  # so much that half of it has changed for sure
    shown = [(still + s * share * (moved.astype(float) - still)).astype(np.uint8) for s in np.linspace(0, 1, 24)]
    assert scene_of(shown, INSIDE) is None


def test_pictures_of_another_size_are_left_out() -> None:
    assert scene_of([np.zeros((10, 10), np.uint8)] * 20, INSIDE) is None
    seen = StillPixels(INSIDE)
    assert seen.count == 0 and seen.scene() is None


def test_a_narrowed_extractor_says_what_is_valid_and_finds_no_edge_elsewhere() -> None:
    whole = DefaultExtractor(DefaultSettings(learned=0.0), LENS)
    image, scene = pictures(1)[0], np.ones((250, 250), bool)
    scene[:, :90] = False
    narrow = whole.through(scene).extract(image)
    assert not whole.extract(image).valid.numel()
    assert float(narrow.valid[:, :44].sum()) == 0 and float(narrow.valid[60:65, 60:100].min()) == 1
    assert float(narrow.edges.points[:, 0].min()) > 88 > float(whole.extract(image).edges.points[:, 0].min())
