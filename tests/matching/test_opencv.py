import cv2
import numpy as np
import pytest
import torch
from matching_shapes import blob

from ursnav_torch.errors import InputError, MissingExtraError
from ursnav_torch.matching import Matching, OpenCV, pack, shape_distances

HAS_CONTRIB = hasattr(cv2, "createShapeContextDistanceExtractor")


@pytest.mark.skipif(HAS_CONTRIB, reason="this OpenCV has its contrib modules")
def test_without_contrib_the_package_is_named() -> None:
    with pytest.raises(MissingExtraError, match="opencv-contrib-python-headless"):
        shape_distances([blob(0)], [blob(1)], "opencv")


@pytest.mark.skipif(not HAS_CONTRIB, reason="this OpenCV lacks its contrib modules")
def test_is_the_extractor_called_pair_by_pair() -> None:
    query, views = blob(0, 50).astype(np.float32), [blob(seed, 50).astype(np.float32) for seed in (1, 2)]
    extractor = cv2.createShapeContextDistanceExtractor()
    expected = [extractor.computeDistance(query[None], v[None]) for v in views]
    found = shape_distances([query], [*views, np.zeros((0, 2))], "opencv")[0]
    np.testing.assert_allclose(found[:2].numpy(), expected, rtol=1e-5)
    assert torch.isinf(found[2])


def test_refuses_settings() -> None:
    with pytest.raises(InputError, match="at least 1"):
        OpenCV(iterations=0)
    with pytest.raises(InputError, match="no roll search"):
        Matching(method=OpenCV(), roll_deg=(0.0, 5.0))
    assert pack([]).points.shape == (0, 1, 2)
