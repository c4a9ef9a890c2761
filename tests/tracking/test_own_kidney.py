"""The sequential test whether this is the VID's kidney, and the mirrored picture that a track's fit is held against."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flights import flight

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.own_kidney import KidneyEvidence, OwnKidneyTest, mirrored
from ursnav_torch.tracking.settings import OwnKidneySettings, TrackSettings
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid

GOOD, BAD = KidneyEvidence(0.8, 1.5), KidneyEvidence(0.4, 1.2)


def after(evidence: KidneyEvidence, pictures: int, seconds: float = 0.1) -> OwnKidneyTest:
    test = OwnKidneyTest(OwnKidneySettings())
    for _ in range(pictures):
        test.add(evidence, seconds)
    return test


def test_a_few_good_pictures_are_believed_and_bad_ones_give_up_later() -> None:
    assert after(GOOD, 1).verdict is None and after(GOOD, 3).verdict is True
    assert after(GOOD, 3).in_doubt and not after(GOOD, 5).in_doubt
    assert after(BAD, 10).verdict is None and after(BAD, 15).verdict is False


def test_a_long_good_track_outlasts_a_bad_stretch_but_not_any() -> None:
    test = after(GOOD, 200)
    for _ in range(10):
        test.add(BAD, 0.1)
    assert test.verdict is True
    for _ in range(80):
        test.add(BAD, 0.1)
    assert test.verdict is False


def test_what_counts_is_time_not_pictures() -> None:
    np.testing.assert_allclose(after(GOOD, 5, seconds=0.02).trust, after(GOOD, 1).trust)


def test_a_gap_counts_as_four_pictures_and_no_more() -> None:
    np.testing.assert_allclose(after(GOOD, 1, seconds=60.0).trust, after(GOOD, 4).trust)
    np.testing.assert_allclose(after(BAD, 1, seconds=60.0).trust, after(BAD, 4).trust)


def test_the_sum_is_believed_from_1_and_a_half_given_up_at_minus_4_and_stays_between_minus_6_and_20() -> None:
    test = OwnKidneyTest(OwnKidneySettings())
    for trust, verdict in ((1.49, None), (1.5, True), (-3.99, None), (-4.0, False)):
        test.trust = trust
        assert test.verdict is verdict
    assert after(GOOD, 1000).trust == 20.0 and after(BAD, 1000).trust == -6.0


def test_a_picture_counts_by_its_weighted_evidence_within_limits() -> None:
    s = OwnKidneySettings(weights=(-4.0, 10.0, -2.0), independent=0.5, max_llr_against=0.8)
    assert KidneyEvidence(0.5, 0.3).log_odds(s) == pytest.approx(0.5 * (-4.0 + 5.0 - 0.6))
    assert KidneyEvidence(0.5, 0.3, off=2.5).log_odds(s) == pytest.approx(0.2 + 0.5)
    assert KidneyEvidence(0.5, 0.3, off=50.0).log_odds(s) == pytest.approx(0.2 - 1.0)  # a wrong sensor
    assert KidneyEvidence(1.0, 0.0).log_odds(s) == s.max_llr_for
    assert KidneyEvidence(0.0, 2.0).log_odds(s) == -0.8


def test_in_doubt_a_picture_counts_beside_its_mirror_image() -> None:
    s = OwnKidneySettings(weights=(-4.0, 10.0, -2.0), doubt_weights=(-2.0, 8.0, -1.0, -3.0), independent=0.5)
    assert KidneyEvidence(0.5, 0.8, 0.2).log_odds(s) == pytest.approx(0.5 * (-2.0 + 4.0 - 0.8 - 0.6))
    assert KidneyEvidence(0.5, 0.8, 0.2, off=2.5).log_odds(s) == pytest.approx(0.3 + 0.5)
    used = OwnKidneySettings()
    assert KidneyEvidence(0.6, 1.2, 0.4).log_odds(used) > KidneyEvidence(0.6, 1.2, 0.45).log_odds(used)


def test_a_kidney_is_in_doubt_below_the_sum_that_is_believed() -> None:
    test = OwnKidneyTest(OwnKidneySettings())
    assert test.in_doubt
    test.trust = 2.99
    assert test.in_doubt
    test.trust = 3.0
    assert not test.in_doubt and test.verdict is True


def test_what_spoke_for_one_place_does_not_speak_for_another() -> None:
    test = OwnKidneyTest(OwnKidneySettings())
    test.trust = 20.0
    test.leapt()
    assert test.in_doubt and test.verdict is None
    test.trust = -3.0
    test.leapt()
    assert test.trust == -3.0


def test_weights_that_are_too_few_are_refused() -> None:
    with pytest.raises(InputError, match="3 weights, and 4 in doubt"):
        OwnKidneySettings(doubt_weights=(1.0,))  # type: ignore[arg-type]


def test_every_kind_of_evidence_counts_its_way() -> None:
    def odds(score: float = 0.5, fit: float = 1.2, off: float | None = None) -> float:
        free = OwnKidneySettings(max_llr_for=9.0, max_llr_against=9.0)
        return KidneyEvidence(score, fit, off=off).log_odds(free)

    assert odds(score=0.52) > odds() > odds(score=0.48)
    assert odds(fit=1.1) > odds() > odds(fit=1.3)  # more to be seen, and aligned no better
    assert odds(off=0.5) > odds() > odds(off=9.0)
    assert odds(score=0.0) < -2.0 and odds(score=1.0) > 2.0


def test_a_picture_that_is_surely_found_by_itself_speaks_for_the_kidney() -> None:
    s = OwnKidneySettings(max_llr_for=9.0, max_llr_against=9.0)
    plain, found = (KidneyEvidence(0.4, 1.2, relocated=sure).log_odds(s) for sure in (False, True))
    assert found - plain == pytest.approx(s.independent * s.relocated_llr)


def seen_by(tracker: Tracker, renderer: RaycastRenderer, poses: np.ndarray, mirror: bool = False) -> list[Tracked]:
    images = [renderer.render(T).image for T in poses]
    return [tracker.step(np.ascontiguousarray(im[:, ::-1]) if mirror else im, i / 10) for i, im in enumerate(images)]


def test_a_mirror_changes_the_sides_about_the_lens_axis_and_twice_gives_the_picture(lens: Camera) -> None:
    planes = torch.arange(160.0).reshape(2, 8, 10)
    middle = replace(lens, width=10, height=8, cx=4.5, cy=3.5)
    torch.testing.assert_close(mirrored(planes, middle)[0, 0], torch.arange(9.0, -1.0, -1.0))
    aside = replace(middle, cx=5.0)  # column 5 is the axis and stays
    torch.testing.assert_close(mirrored(planes, aside)[..., 5], planes[..., 5])
    torch.testing.assert_close(mirrored(mirrored(planes, aside), aside), planes)


def test_pictures_of_the_mirrored_kidney_are_believed_without_a_decoy_and_never_with_it(
    vid: Vid, renderer: RaycastRenderer, phantom: Kidney
) -> None:
    poses = np.concatenate([flight(phantom, calyx)[::-1] for calyx in (0, 1)])
    never = TrackSettings(own_kidney=OwnKidneySettings(doubt_below=-99.0))
    taken_in = [a.state == TRACKING for a in seen_by(Tracker(vid, never), renderer, poses, mirror=True)]
    assert np.mean(taken_in) > 0.5, "the mirrored kidney must be one that is easily believed"
    answers = seen_by(Tracker(vid), renderer, poses, mirror=True)
    assert TRACKING not in [a.state for a in answers]
    told = [a.evidence for a in answers if a.evidence is not None]
    assert np.median([e.score - e.decoy for e in told if e.decoy is not None]) < 0  # the decoy is the kidney itself


def test_a_track_asks_the_decoy_until_it_is_believed_and_again_after_a_reset(
    vid: Vid, renderer: RaycastRenderer, phantom: Kidney
) -> None:
    tracker = Tracker(vid)
    for _ in range(2):
        told = [a.evidence for a in seen_by(tracker, renderer, flight(phantom, 1)[:8])]
        asked = [e.decoy is not None for e in told if e is not None]
        assert asked[0] and not any(asked[3:])
        tracker.reset()


def test_a_decoy_that_begins_anew_knows_nothing_of_the_pictures_before(
    vid: Vid, renderer: RaycastRenderer, phantom: Kidney
) -> None:
    """After a reset, and after a pause longer than a track is bridged for."""
    tracker, poses = Tracker(vid), flight(phantom, 1)
    first, there = (
        tracker._reader.mirrored(found)
        for T in (poses[0], poses[-1])
        if (found := tracker.extract(renderer.render(T).image))
    )
    fresh = tracker._decoy.score(first, 0.0)
    for begin_s, forget in ((0.0, tracker.reset), (100.0, lambda: None)):
        tracker._decoy.score(there, begin_s)
        forget()
        assert tracker._decoy.score(first, begin_s + 10.0) == fresh
