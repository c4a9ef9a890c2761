"""Confidence is learned from pictures that are no views of the VID, and from what was answered to them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.localization.evidence import CALYX_NUMBERS, NUMBERS, REFINED_NUMBERS, Evidence
from ursnav_torch.localization.fitting import NOTHING
from ursnav_torch.localization.learn import NONE_SHARE, ask, learn_confidence, queries_from, simulated_queries
from ursnav_torch.localization.learned import asked_from_table
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS
from ursnav_torch.vid import PlanSettings, Vid, plan_views

PLAN = PlanSettings(views_per_calyx=2, passage_views=2, seed=5)


class AlwaysFirst:
    """Answers calyx 0 to everything from where the kidney's frame begins; its numbers tell nothing."""

    def __init__(self, vid: Vid, *_: Any) -> None:
        self.vid = vid

    def features(self, image: np.ndarray) -> np.ndarray:
        return image

    def evidence_settings(self) -> str:
        return "always the first"

    def judge(self, features: np.ndarray) -> SimpleNamespace:
        calyces = len(self.vid.kidney.calyces) + 1
        nearest = Evidence(1, np.full(len(NUMBERS) - REFINED_NUMBERS, 0.5), np.ones((calyces, 2)))
        return SimpleNamespace(
            evidence=Evidence(0, np.ones(len(NUMBERS)), np.ones((calyces, len(CALYX_NUMBERS)))),
            nearest=nearest,
            calyx=0,
        )

    def pose(self, _: SimpleNamespace) -> np.ndarray:
        return np.eye(4)

    def nearest_pose(self, _: SimpleNamespace) -> np.ndarray:
        return np.eye(4)


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
    refined, nearest = (asked_from_table(found["confidence"]["pictures"], way) for way in (True, False))
    assert refined.answer.tolist() == [0] * found["queries"] and nearest.answer.tolist() == [1] * found["queries"]
    nothing = np.isnan(refined.position_mm)
    assert nothing.sum() == round(NONE_SHARE * asked) and (refined.shown[nothing] == NOTHING).all()
    assert int(refined.right.sum()) == found["right"]


def test_errors_are_from_the_true_pose_in_anatomy(vid: Vid) -> None:
    query = next(iter(simulated_queries(vid, RaycastRenderer, PLAN, np.random.default_rng(1))))
    row = ask(AlwaysFirst(vid), [query], lambda n: None)[0]  # type: ignore[arg-type]
    T = query.T_kidney_camera
    assert row["refined"][1] == pytest.approx(np.linalg.norm(T[:3, 3]) / vid.kidney.scale)
    assert row["refined"][2] == pytest.approx(np.degrees(np.arccos(T[2, 2]))) == row["nearest"][2]
    assert row["far"] == pytest.approx(vid.lumen.to_calyces(T[:3, 3])[0, query.calyx])


def test_queries_show_the_calyx_they_say_at_the_pose_they_say(vid: Vid, phantom_lumen: LumenDistance) -> None:
    queries = list(simulated_queries(vid, RaycastRenderer, PLAN, np.random.default_rng(1)))
    views = plan_views(vid.kidney, phantom_lumen, PLAN)
    assert [q.calyx for q in queries] == views.calyx.tolist()
    np.testing.assert_allclose([q.T_kidney_camera for q in queries], views.T_kidney_camera)
    assert {q.preset for q in queries} == {"thesis_simulation", "thesis_phantom", "in_vivo_like"}
    assert all(q.image.shape == (96, 96, 3) and q.image.std() > 3 for q in queries)


def test_a_larger_kidney_moves_and_swells_by_as_much_more(vid: Vid, monkeypatch: pytest.MonkeyPatch) -> None:
    """A printed kidney: its pictures are drawn in one that changed as the kidney itself would have."""
    drawn: list[tuple[np.ndarray, np.ndarray]] = []

    def simulated(mesh: Any, T: np.ndarray, *_: Any) -> None:
        drawn.append((np.asarray(mesh.vertices), T))

    monkeypatch.setattr("ursnav_torch.localization.learn.simulate", simulated)
    for scale in (1.0, 2.0):
        T, rng = vid.T_kidney_camera[3:4].copy(), np.random.default_rng(1)
        T[:, :3, 3] *= scale
        printed = replace(vid, kidney=vid.kidney.scaled(scale))
        list(queries_from(printed, lambda mesh, _: mesh, T, vid.calyx[3:4], rng, {"in_vivo": PRESETS["in_vivo_like"]}))
    (moved, T), (twice, T_twice) = drawn
    assert np.abs(moved - vid.kidney.mesh.vertices).max() > 0.3
    np.testing.assert_allclose(twice, 2 * moved, atol=1e-2)
    T[:3, 3] *= 2
    np.testing.assert_allclose(T_twice, T, atol=1e-2)
