"""What a track says of its own answers: the calyces left, and how far off a pose may be."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.localization.certainty import LEVELS
from ursnav_torch.localization.learned import PositionErrors, TrackWeights
from ursnav_torch.tracking.certainty import (
    TrackCertaintySettings,
    TrackEvidence,
    joined_certainty,
    track_certainty,
    track_evidence,
)
from ursnav_torch.tracking.motion import Hypotheses
from ursnav_torch.tracking.relocalization import Relocated

ERRORS = PositionErrors((1.0, -2.0, 0.5), 1.8)
TOLD = PositionErrors((0.0, -2.0, 0.5), 1.5)
WEIGHTS = TrackWeights(tuple(0.2 - 0.01 * i for i in range(len(LEVELS))), ERRORS, TOLD, (2.0, -2.0, 0.0))


def evidence(score: float = 0.8, spread_mm: float = 1.0) -> TrackEvidence:
    return TrackEvidence(1, np.array([0.15, 0.7, 0.02, 0.13]), score, spread_mm, 5.0)


def test_a_calyx_with_enough_of_the_probability_is_left_and_the_answer_always() -> None:
    assert track_certainty(evidence(), WEIGHTS, ERRORS, LEVELS[6], 1.0).calyces == (1, 0)  # 0.14 is asked for
    assert track_certainty(evidence(), WEIGHTS, ERRORS, LEVELS[8], 1.0).calyces == (1, 0, -1)
    assert track_certainty(evidence(), WEIGHTS, ERRORS, LEVELS[0], 1.0).calyces == (1,)
    assert set(track_certainty(evidence(), WEIGHTS, ERRORS, 0.999, 1.0).calyces) == {-1, 0, 1, 2}


def test_errors_grow_with_the_spread_and_with_a_worse_alignment_and_with_the_kidney() -> None:
    def mm(scale: float = 1.0, **given: float) -> float:
        return track_certainty(evidence(**given), WEIGHTS, ERRORS, 0.95, scale).position_sd_mm

    assert mm() == pytest.approx(np.exp(1.0 - 1.6 + 0.5 * np.log(1.1)))
    assert mm(score=0.5) == pytest.approx(np.exp(0.6) * mm()) and mm(spread_mm=4.0) > mm()
    assert mm(scale=1.8) == pytest.approx(1.8 * mm())


def test_errors_of_a_track_that_a_robot_told_of_are_its_own() -> None:
    plain, told = (track_certainty(evidence(), WEIGHTS, errors, 0.95, 1.0) for errors in (ERRORS, TOLD))
    assert told.position_sd_mm == pytest.approx(plain.position_sd_mm / np.e) and told.calyces == plain.calyces
    assert told.region_mm == pytest.approx(1.5 * told.position_sd_mm)


def test_evidence_is_the_hypotheses_and_half_of_it_the_tracks_own() -> None:
    T = np.eye(4)[None].repeat(3, 0)
    T[:, 0, 3] = [0.0, 0.0, 4.0]
    found = Hypotheses(T, np.zeros((3, 2)), np.array([0.5, 0.25, 0.25]))
    e = track_evidence(found, np.array([0, -1, 1]), 0, np.eye(4), 0.7, 2.0)
    np.testing.assert_allclose(e.share, [0.75, 0.125, 0.125])
    assert e.spread_mm == pytest.approx(np.sqrt(0.25 * 16.0) / 2.0) and e.spread_deg == pytest.approx(0.0, abs=1e-6)


def test_what_nobody_saw_makes_errors_larger() -> None:
    told = track_certainty(evidence(), WEIGHTS, ERRORS, 0.95, 1.0)
    later = told.later(3.0, 10.0)
    assert later.position_sd_mm == pytest.approx(np.hypot(told.position_sd_mm, 3.0))
    assert later.direction_sd_deg == pytest.approx(np.hypot(told.direction_sd_deg, 10.0))
    assert later.of(0).calyces[0] == 0 and sorted(later.of(0).calyces) == sorted(told.calyces)


def test_a_sensor_makes_a_pose_surer_and_never_less() -> None:
    """Two of three points of a Gaussian in space lie within 1.88 of an axis's standard deviations."""
    told = track_certainty(evidence(score=0.0), WEIGHTS, ERRORS, 0.95, 1.0)
    assert told.sensed(1e9).position_sd_mm == pytest.approx(told.position_sd_mm)
    assert replace(told, position_sd_mm=1e9).sensed(0.5).position_sd_mm == pytest.approx(0.94)
    assert told.sensed(0.5).position_sd_mm < 0.94


def test_the_region_that_holds_nine_of_ten_is_wider_than_that_of_two_of_three() -> None:
    told = track_certainty(evidence(), WEIGHTS, ERRORS, 0.95, 1.0)
    assert told.region_mm == pytest.approx(1.8 * told.position_sd_mm)


def test_two_ways_leave_what_both_leave() -> None:
    one = track_certainty(evidence(), WEIGHTS, ERRORS, LEVELS[8], 1.0)
    other = track_certainty(evidence(score=0.9), WEIGHTS, ERRORS, LEVELS[6], 1.0)
    both = joined_certainty([one, other], 1)
    assert both is not None and both.calyces == (1, 0) and both.position_sd_mm == other.position_sd_mm
    assert joined_certainty([], 1) is None


def test_refusals() -> None:
    with pytest.raises(InputError, match="0 < set_probability < 1"):
        TrackCertaintySettings(1.0)
    with pytest.raises(InputError, match="largest_mm > 0, got 0"):
        TrackCertaintySettings(largest_mm=0)


def test_a_picture_surely_found_by_itself_tells_how_far_off_a_pose_is() -> None:
    told, there = track_certainty(evidence(), WEIGHTS, ERRORS, 0.95, 1.0), np.eye(4)
    there[0, 3] = 0.3
    assert told.relocated(np.eye(4), Relocated(there, 0.4)).position_sd_mm == pytest.approx(0.5)
    assert told.relocated(np.eye(4), Relocated(there, 99.0)).position_sd_mm == told.position_sd_mm
