"""How a video's pictures are read: the wall network's share is the track's own choice, not the VID's."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ursnav_torch.errors import InputError
from ursnav_torch.features.network import WallReader
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.settings import ReadingSettings, TrackSettings
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid


@pytest.fixture
def image(vid: Vid, renderer: RaycastRenderer) -> np.ndarray:
    return renderer.render(vid.T_kidney_camera[3]).image


def relief(vid: Vid, image: np.ndarray, learned: float | None) -> np.ndarray:
    features = Tracker(vid, TrackSettings(ReadingSettings(learned))).extract(image)
    assert features is not None
    return features.fields[0].numpy()


def test_the_share_of_the_network_is_the_tracks_own(vid: Vid, image: np.ndarray) -> None:
    """Null takes the VID's; a share changes the relief of the pictures, and nothing of the VID."""
    as_set, none, half = (relief(vid, image, share) for share in (None, 0.0, 0.5))
    np.testing.assert_array_equal(as_set, relief(vid, image, vid.settings.learned))  # type: ignore[union-attr]
    assert np.abs(half - none).max() > 0.1
    plain = replace(vid, settings=replace(vid.settings, learned=0.0))
    np.testing.assert_array_equal(none, relief(plain, image, None))


def test_what_lies_before_the_wall_is_told_at_any_share(
    vid: Vid, image: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The network is asked for it as long as the VID's features ask one, and for the rest where that has a share."""
    lens = Tracker(vid).working_camera
    stone = torch.zeros(2, lens.height, lens.width)
    stone[0, lens.height // 3 : lens.height // 2, lens.width // 3 : lens.width // 2] = 0.99
    monkeypatch.setattr(WallReader, "before", lambda reader, image: stone)
    features = Tracker(vid, TrackSettings(ReadingSettings(0.0))).extract(image)
    assert features is not None and [body.kind for body in features.bodies] == ["stone"] and not features.read.numel()
    features = Tracker(vid, TrackSettings(ReadingSettings(0.5))).extract(image)
    assert features is not None and features.read.numel()
    plain = replace(vid, settings=replace(vid.settings, learned=0.0))
    features = Tracker(plain, TrackSettings(ReadingSettings(0.5))).extract(image)
    assert features is not None and not features.read.numel() and not features.bodies


def test_a_share_is_one() -> None:
    with pytest.raises(InputError, match=r"learned=1.5 must lie in 0..1"):
        ReadingSettings(1.5)
