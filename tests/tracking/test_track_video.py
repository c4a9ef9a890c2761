from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flights import flight

from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.track_rows import track_rows
from ursnav_torch.search import VIDEO_SEARCH
from ursnav_torch.tracking.follow import Moment, Source, follow_source
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.tracker import Tracked, Tracker
from ursnav_torch.vid import Vid


@pytest.fixture(scope="module")
def moments(phantom: Kidney, renderer: RaycastRenderer) -> list[Moment]:
    """Eight pictures on the way to a calyx, the fifth all white."""
    images = [renderer.render(T).image for T in flight(phantom, 1)[-8:]]
    images[4] = np.full_like(images[4], 255)
    return [Moment(i, i / 10, image, str(i)) for i, image in enumerate(images)]


@pytest.mark.parametrize("live", [False, True])
def test_reading_ahead_changes_no_answer(vid: Vid, moments: list[Moment], live: bool) -> None:
    alone, beside = Tracker(vid), Tracker(vid)
    wanted = [alone.step(m.image, m.t_s) for m in moments]
    found = list(follow_source(beside, Source(lambda: iter(moments), len(moments), "pictures", live)))
    assert [m.frame for m, _ in found] == list(range(len(moments)))
    for (_, a), b in zip(found, wanted, strict=True):
        assert (a.state, a.calyx, a.confidence) == (b.state, b.calyx, b.confidence)
        assert (a.T_kidney_camera is None) == (b.T_kidney_camera is None)
        if a.T_kidney_camera is not None and b.T_kidney_camera is not None:
            np.testing.assert_array_equal(a.T_kidney_camera, b.T_kidney_camera)


@pytest.mark.parametrize(("every_s", "most"), [(0.0, 1.0), (0.35, 0.75)])
def test_a_settled_track_is_weighed_against_all_views_now_and_then(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch, every_s: float, most: float
) -> None:
    """And still knows, in every picture, where it is and how far the hypotheses lie from there."""
    settings = TrackSettings()
    tracker = Tracker(vid, replace(settings, filter=replace(settings.filter, every_s=every_s)))
    looked, update = [], tracker._filter.update
    monkeypatch.setattr(tracker._filter, "update", lambda *given: (looked.append(1), update(*given))[1])
    way = flight(phantom, 1)
    answers = [tracker.step(renderer.render(T).image, i / 10) for i, T in enumerate(way)]
    settled = [(a, T) for a, T in zip(answers, way, strict=True) if a.state == "tracking"]
    assert len(settled) > 0.6 * len(way)
    weighed = len(looked) - sum(a.evidence is not None and a.evidence.decoy is not None for a in answers)
    assert weighed <= most * len(way) and (every_s or weighed == len(way))
    for answer, T in settled[1:]:  # of the first, hypotheses come from one picture alone
        assert answer.T_kidney_camera is not None and answer.certainty is not None and answer.places is not None
        assert np.linalg.norm(answer.T_kidney_camera[:3, 3] - T[:3, 3]) < 1.5
        assert answer.certainty.evidence.spread_mm < 6.0
    quiet = [a for a, _ in settled if a.evidence is None]
    assert len(quiet) == len(way) - weighed


def rows_of(vid: Vid, pictures: Callable[[], Iterator[Moment]]) -> Iterator[tuple[dict[str, Any], Tracked]]:
    tracker = Tracker(vid)
    return track_rows(tracker, follow_source(tracker, Source(pictures, 2, "pictures")))


def test_a_source_that_breaks_says_so_and_one_without_pictures_gives_no_row(vid: Vid, moments: list[Moment]) -> None:
    def broken():  # type: ignore[no-untyped-def]
        yield moments[0]
        raise OSError("the disk is gone")

    rows = rows_of(vid, broken)
    assert next(rows)[0]["frame"] == 0
    with pytest.raises(OSError, match="disk is gone"):
        next(rows)
    assert list(rows_of(vid, lambda: iter(()))) == []


def test_edge_points_are_extracted_where_somebody_reads_them(vid: Vid, moments: list[Moment]) -> None:
    image, plain = moments[0].image, Tracker(vid)
    features = plain.extract(image)
    assert features is not None and not len(features.edges) and not features.maps.numel() and len(features.fields) == 1
    shown = plain.extract(image, edges=True)
    assert shown is not None and len(shown.edges) >= 10
    shapes = Tracker(vid, search=replace(VIDEO_SEARCH, shape_weight=1.0))
    matched = shapes.extract(image)
    assert matched is not None and len(matched.edges) >= 10
    assert plain.extract(moments[4].image) is None, "an all white picture shows nothing"


def test_a_picture_with_few_edge_points_is_followed_all_the_same(vid: Vid, moments: list[Moment]) -> None:
    """Its shading says where it is; shapes, where they count, have no say in it."""
    strict = replace(vid, settings=replace(vid.settings, points=9000, min_points=9000))  # type: ignore[type-var]
    for edges in (False, True):
        features = Tracker(strict).extract(moments[0].image, edges)
        assert features is not None and not len(features.edges)
    tracker = Tracker(vid, search=replace(VIDEO_SEARCH, shape_weight=1.0))
    features = Tracker(vid).extract(moments[0].image)
    assert np.isfinite(tracker.follow(features, 0.0).fit)
