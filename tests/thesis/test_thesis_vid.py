"""The experiment's VID: certainty is learned for the localizer that is tested, and no other experiment's is taken."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.camera import Camera
from ursnav_torch.features import DefaultSettings
from ursnav_torch.files import no_progress
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.localization import Localizer
from ursnav_torch.matching import Matching
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.thesis import Pipeline, ProtocolSettings
from ursnav_torch.thesis import run as thesis_run
from ursnav_torch.vid import PlanSettings


def test_certainty_is_learned_for_the_localizer_that_is_tested(
    phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(thesis_run, "build_vid", lambda *given, **named: asked.append(named["learn"]))
    marks = []
    for make in (partial(Localizer, matching=None), partial(Localizer, matching=Matching())):
        pipeline = Pipeline(lens, DefaultSettings(), RaycastRenderer, PlanSettings(), make, True, 1)
        settings = ProtocolSettings()
        thesis_run._prepared_vid(phantom, phantom_lumen, pipeline, settings, np.eye(4), tmp_path, no_progress)
        assert asked[-1].keywords["make_localizer"] is make
        marks.append((tmp_path / "made_for.txt").read_text(encoding="utf-8"))
    assert marks[0] != marks[1], "what was learned for one is not taken for the other"
