"""A track leaves out what never changes in its first pictures, and takes that back when it changes after all."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.track import put_back
from ursnav_torch.tracking import reading
from ursnav_torch.tracking.follow import Moment, Source
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid


def test_burnt_in_text_is_left_out_until_it_moves(
    vid: Vid, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_LOOKED_AT", (16, 24))
    plain = replace(vid, settings=replace(vid.settings, learned=0.0))  # the network alone would take it for a stone
    tracker, rng = Tracker(plain), np.random.default_rng(3)
    rows = rng.choice(len(vid), 24, replace=False)
    valid = []
    for number, row in enumerate(rows):
        image = (renderer.render(vid.T_kidney_camera[row]).image * rng.uniform(0.4, 1)).astype(np.uint8)
        size = image.shape[0]
        if number < 20:
            cv2.rectangle(image, (size // 4, size // 6), (3 * size // 4, size // 3), 250, -1)
        features = tracker.extract(image)
        assert features is not None
        valid.append(features.valid)
    assert not any(v.numel() for v in valid[:15])
    covered = valid[16]
    assert float(covered[covered.shape[0] // 4, covered.shape[1] // 2]) == 0 < float(covered.mean())
    assert not valid[-1].numel(), "what has changed by the last look was no text"


def test_what_was_cut_away_is_none_of_the_scene(vid: Vid, renderer: RaycastRenderer) -> None:
    lens = vid.camera
    cut = vid.cut_of(lens.cropped(0, 16, lens.width, lens.height - 32), was_cut=True)
    tracker, image = Tracker(vid), renderer.render(vid.T_kidney_camera[3]).image
    source = Source(lambda: iter([Moment(0, 0.0, image[16:-16], "0")]), 1, "one")
    (moment,) = put_back(source, cut, tracker).moments()
    assert moment.image.shape == image.shape and not moment.image[:16].any()
    features = tracker.extract(moment.image)
    assert features is not None and float(features.valid[:2].max()) == 0 < float(features.valid.mean())
