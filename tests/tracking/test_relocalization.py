"""Pictures that a track cannot place, located anew as stills are."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flights import flight

from ursnav_torch.errors import InputError
from ursnav_torch.features import Features
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.follow import Moment, Source, follow_source
from ursnav_torch.tracking.offline import follow_both_ways
from ursnav_torch.tracking.relocalization import RelocalizationSettings, Relocalizer, Relocated
from ursnav_torch.tracking.settings import ChallengerSettings, TrackSettings
from ursnav_torch.tracking.tracker import TRACKING, Tracker
from ursnav_torch.vid import Vid


class Told:
    """Answers every picture with one pose, or is never sure, and counts the pictures."""

    def __init__(self, T_kidney_camera: np.ndarray | None) -> None:
        self.answer = None if T_kidney_camera is None else Relocated(T_kidney_camera, 1e-3)
        self.asked = 0

    def look_through(self, scene: np.ndarray | None) -> None:
        """Whatever of a picture is shown, the answer is the same."""

    def locate(self, image: np.ndarray, seen: Features) -> Relocated | None:
        self.asked += 1
        return self.answer


def features_of(vid: Vid, image: np.ndarray) -> Features:
    found = Tracker(vid, TrackSettings(relocalization=RelocalizationSettings(above_mm=np.inf))).extract(image)
    assert found is not None
    return found


def test_a_clear_picture_is_found_where_it_was_taken(vid: Vid, phantom: Kidney, renderer: RaycastRenderer) -> None:
    T = flight(phantom, 2)[-1]
    image = renderer.render(T).image
    relocalizer, seen = Relocalizer(vid), features_of(vid, image)
    relocalizer._localizer.threshold = 0.0
    found = relocalizer.locate(image, seen)
    assert found is not None and found.position_sd_mm > 0
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]) < 1.0
    relocalizer._localizer.threshold = 1.01
    assert relocalizer.locate(image, seen) is None, "an answer that is not accepted counts for nothing"


def test_a_picture_of_nothing_is_found_nowhere(vid: Vid, picture: np.ndarray) -> None:
    assert Relocalizer(vid).locate(np.full_like(picture, 255), features_of(vid, picture)) is None


def test_what_the_track_knows_to_be_no_wall_is_left_out(vid: Vid, picture: np.ndarray) -> None:
    relocalizer, seen = Relocalizer(vid), features_of(vid, picture)
    asked: list[Features] = []
    locate = relocalizer._localizer.locate_features
    relocalizer._localizer.locate_features = lambda f: asked.append(f) or locate(f)  # type: ignore[method-assign]
    valid = torch.ones(seen.fields.shape[1:])
    valid[:20] = 0
    relocalizer.locate(picture, replace(seen, valid=valid))
    relocalizer.locate(picture, seen)
    assert not asked[0].valid[:20].any() and asked[0].valid[30:].any()
    assert not asked[1].valid.numel() or asked[1].valid[:20].any()


def test_who_is_asked_looks_through_what_the_track_looks_through(vid: Vid, picture: np.ndarray) -> None:
    tracker, lens = Tracker(vid), vid.camera.pixel_rays()[1]
    asked = tracker._relocalizer
    assert asked is not None
    whole, upper, left = asked._localizer.features(picture), lens.copy(), lens.copy()
    upper[len(upper) // 2 :], left[:, left.shape[1] // 2 :] = False, False
    tracker.narrow(upper)
    cut = asked._localizer.features(picture)
    assert cut.valid.numel() and not cut.valid[len(cut.valid) // 2 + 3 :].any() and whole.valid.shape != cut.valid.shape
    tracker._reader.scene = left
    tracker.step(picture, 0.0)
    both = asked._localizer.features(picture)
    assert both.valid.sum() < 0.7 * cut.valid.sum()
    tracker._reader.scene = None
    tracker.step(picture, 0.1)
    again = asked._localizer.features(picture)
    assert torch.equal(again.valid, cut.valid), "what is found meanwhile may be found otherwise"


def test_a_track_asks_until_it_has_a_place_and_no_more(vid: Vid, phantom: Kidney, renderer: RaycastRenderer) -> None:
    tracker, poses = Tracker(vid), flight(phantom, 2)
    told = tracker._relocalizer = Told(None)  # type: ignore[assignment]
    states = [tracker.step(renderer.render(T).image, i / 10).state for i, T in enumerate(poses)]
    asked = told.asked
    assert states[-1] == TRACKING and 1 <= asked <= 1 + states.index(TRACKING)
    features = tracker.extract(renderer.render(poses[0]).image)
    tracker.reset()
    tracker.follow(features, 100.0)
    assert told.asked == asked, "without a picture nobody can be asked"
    for level, more in ((2, 0), (1, 1)):
        tracker.reset()
        tracker.ease(level)
        tracker.step(renderer.render(poses[0]).image, 200.0)
        assert told.asked == asked + more


def test_a_track_goes_on_where_its_picture_is_surely_found(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer
) -> None:
    """A settled track's picture shows another place, which the filter misses and no leap would be believed to."""
    poses, far = flight(phantom, 2), flight(phantom, 5)[-1]
    image = renderer.render(far).image
    never = ChallengerSettings(reacquire_below=1.01)
    for sure in (True, False):
        tracker = Tracker(vid, TrackSettings(challenger=never, relocalization=RelocalizationSettings(above_mm=0.01)))
        tracker._relocalizer = None
        for i, T in enumerate(poses):
            tracker.step(renderer.render(T).image, i / 10)
        tracker._relocalizer = Told(far if sure else None)  # type: ignore[assignment]
        tracker._pursuit.follow = lambda picture, anew, before=tracker._aligned: before  # type: ignore[method-assign]
        answer = tracker.step(image, len(poses) / 10)
        assert answer.T_kidney_camera is not None and answer.certainty is not None
        off = float(np.linalg.norm(answer.T_kidney_camera[:3, 3] - far[:3, 3]))
        assert (off < 1.0) is sure
        assert not sure or answer.certainty.position_sd_mm <= np.hypot(1e-3, off), "the still's word on the error"
        assert answer.evidence is not None and answer.evidence.relocated is sure


def test_a_recording_is_followed_with_its_pictures_at_hand(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer
) -> None:
    moments = [Moment(i, i / 10, renderer.render(T).image, str(i)) for i, T in enumerate(flight(phantom, 2)[:3])]
    source = Source(lambda: iter(moments), len(moments), "pictures")
    for follow in (follow_source, follow_both_ways):
        tracker = Tracker(vid)
        told = tracker._relocalizer = Told(None)  # type: ignore[assignment]
        assert len(list(follow(tracker, source))) == len(moments)
        assert told.asked >= 1


def test_nobody_is_asked_where_nothing_is_known_of_confidence(
    vid: Vid, picture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    relocalizer, seen = Relocalizer(vid), features_of(vid, picture)
    monkeypatch.setattr(relocalizer._localizer, "_certainty", None)
    monkeypatch.setattr(relocalizer._localizer, "features", lambda image: pytest.fail("this takes time for nothing"))
    assert relocalizer.locate(picture, seen) is None


def test_a_track_that_never_asks_has_nobody_to_ask(vid: Vid) -> None:
    tracker = Tracker(vid, TrackSettings(relocalization=RelocalizationSettings(above_mm=np.inf)))
    assert tracker._relocalizer is None


def test_settings_without_a_meaning_are_refused() -> None:
    for above_mm in (0.0, np.nan):
        with pytest.raises(InputError, match="above_mm > 0, got"):
            RelocalizationSettings(above_mm)
