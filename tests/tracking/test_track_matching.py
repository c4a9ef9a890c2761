"""Shapes in a video's search: each way of matching, as its configuration has it, is asked and follows the scope."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flights import flight
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ursnav_torch.kidney import Kidney
from ursnav_torch.matching import Hungarian, Nearest, Sinkhorn
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import VIDEO_SEARCH
from ursnav_torch.tracking.relocalization import RelocalizationSettings
from ursnav_torch.tracking.settings import OwnKidneySettings, TrackSettings
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid

CONFIGS = Path(__file__).parents[2] / "configs" / "matching"


@pytest.mark.parametrize(("name", "method"), [("nearest", Nearest), ("sinkhorn", Sinkhorn), ("hungarian", Hungarian)])
def test_a_flight_is_followed_with_every_way_of_matching(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, name: str, method: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def counted(self: Any, *given: Any, assign: Any = method.assign) -> Any:
        asked.append(given[0].shape[1])
        return assign(self, *given)

    monkeypatch.setattr(method, "assign", counted)
    matching = instantiate(OmegaConf.load(CONFIGS / f"{name}.yaml"))
    alone = RelocalizationSettings(above_mm=np.inf)  # nor does a still, nor the decoy
    certain = TrackSettings(own_kidney=OwnKidneySettings(doubt_below=-99.0), relocalization=alone)
    tracker = Tracker(vid, certain, search=replace(VIDEO_SEARCH, shape_weight=2.0), matching=matching)
    poses = flight(phantom, 1)[-6:]
    answers = [tracker.step(renderer.render(T).image, i / 10) for i, T in enumerate(poses)]
    assert len(asked) == 6 and min(asked) > 10, "all hypotheses at once, picture by picture"
    for answer, T in zip(answers[3:], poses[3:], strict=True):
        assert answer.T_kidney_camera is not None
        assert np.linalg.norm(answer.T_kidney_camera[:3, 3] - T[:3, 3]) < 1.0
