"""Confidence is learned from pictures that are no views of the VID, and from what was answered to them."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.localization.learn import NONE_SHARE, learn_confidence, simulated_queries
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import PlanSettings, Vid, plan_views

PLAN = PlanSettings(views_per_calyx=2, passage_views=2, seed=5)
NUMBERS = 7


class AlwaysFirst:
    """Answers calyx 0 to everything, voting for calyx 1; its numbers tell nothing."""

    refines = True

    def __init__(self, vid: Vid, *_: Any) -> None:
        self._rng = np.random.default_rng(0)

    def features(self, image: np.ndarray) -> np.ndarray:
        return image

    def evidence_settings(self) -> str:
        return "always the first"

    def judge(self, features: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(numbers=self._rng.normal(size=NUMBERS), calyx=0, voted=1)


@dataclass(frozen=True)
class Learned:
    """What was learned, and the poses (4, 4) that pictures were drawn from meanwhile."""

    result: dict[str, Any]
    drawn: list[np.ndarray]


@pytest.fixture(scope="module")
def learned(vid: Vid) -> Learned:
    drawn: list[np.ndarray] = []
    render = RaycastRenderer.render

    def remembering(self: RaycastRenderer, T: np.ndarray, *more: Any) -> Any:
        drawn.append(np.array(T))
        return render(self, T, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RaycastRenderer, "render", remembering)
        found = learn_confidence(vid, RaycastRenderer, PLAN, 2, make_localizer=AlwaysFirst)  # type: ignore[arg-type]
        return Learned(found, drawn)


def nearest(poses: list[np.ndarray], views: np.ndarray) -> np.ndarray:
    """(N,) how far each pose (4, 4) is from the most alike of the views (V, 4, 4)."""
    return np.array([np.abs(views - T).max((1, 2)).min() for T in poses])


def test_no_picture_is_drawn_from_where_the_vids_views_were(
    phantom: Kidney, phantom_lumen: LumenDistance, learned: Learned
) -> None:
    """Queries planned with the views' own seed would be the views: every answer right, and confidence for nothing."""
    views = plan_views(phantom, phantom_lumen, PLAN).T_kidney_camera
    assert len(learned.drawn) >= len(views) and nearest(list(views), views).max() == 0.0
    assert nearest(learned.drawn, views).min() > 1e-3


def test_what_is_counted_right_is_the_answer_and_pictures_of_nothing_never_are(vid: Vid, learned: Learned) -> None:
    found, asked = learned.result, 2 * (len(vid.kidney.calyces) + 1)
    assert found["queries"] == asked + round(NONE_SHARE * asked)
    counts = np.array(found["look_alikes"]["counts"])
    assert counts.sum() == asked == counts[:, 0].sum()  # calyx 0 was the answer to all, nothing is no row
    assert 2 <= found["right"] == counts[0, 0] < 5
    assert found["confidence"]["settings"] == "always the first"
    assert len(found["confidence"]["refined"]) == 1 + NUMBERS
    assert len(found["confidence"]["nearest"]) == 1 + NUMBERS - 2


def test_queries_show_the_calyx_they_say_at_the_pose_they_say(vid: Vid, phantom_lumen: LumenDistance) -> None:
    queries = list(simulated_queries(vid, RaycastRenderer, PLAN, np.random.default_rng(1)))
    views = plan_views(vid.kidney, phantom_lumen, PLAN)
    assert [q.calyx for q in queries] == views.calyx.tolist()
    np.testing.assert_allclose([q.T_kidney_camera for q in queries], views.T_kidney_camera)
    assert {q.preset for q in queries} == {"thesis_simulation", "thesis_phantom", "in_vivo_like"}
    assert all(q.image.shape == (96, 96, 3) and q.image.std() > 3 for q in queries)
