"""Whether the track is where it should be: pictures vouch for it, time takes that back, and the region says so."""

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.tracking.belief import REGION_90
from ursnav_torch.tracking.own_kidney import KidneyEvidence
from ursnav_torch.tracking.place_test import PlaceTest, calyx_set, region_sd_mm
from ursnav_torch.tracking.settings import PlaceSettings

GOOD, BAD = KidneyEvidence(0.9, 0.2, 1.3), KidneyEvidence(0.3, -0.3, 1.0)
NOBODY = np.zeros(0)


def test_a_few_good_pictures_make_a_place_and_a_few_bad_ones_take_it_back():
    test = PlaceTest(PlaceSettings())
    assert test.right < 0.5
    for _ in range(4):
        test.add(test.llr(GOOD), 0.1)
    assert test.right > 0.95
    for _ in range(4):
        test.add(test.llr(BAD), 0.1)
    assert test.right < 0.5


def test_pictures_closer_together_err_together():
    often, seldom = PlaceTest(PlaceSettings()), PlaceTest(PlaceSettings())
    often.add(1.0, 0.025)
    seldom.add(1.0, 0.1)
    first = PlaceSettings().first
    assert often.log_odds - first == pytest.approx((seldom.log_odds - first) / 2) == pytest.approx(0.5)


def test_time_alone_makes_a_right_place_doubtful():
    test = PlaceTest(PlaceSettings())
    for _ in range(10):
        test.add(test.llr(GOOD), 0.1)
    before = test.right
    test.passed(20.0)
    assert 0.6 < test.right < before


def test_the_region_of_a_sure_place_is_its_own_and_that_of_a_doubtful_one_reaches_the_others():
    away, weight = np.array([15.0, 20.0]), np.array([0.3, 0.2])
    sure = region_sd_mm(1.0, 0.5, NOBODY, NOBODY)
    assert sure == pytest.approx(0.5, rel=0.1)
    assert region_sd_mm(0.97, 0.5, away, weight) < 0.7
    assert region_sd_mm(0.6, 0.5, away, weight) * REGION_90 >= 15.0
    anywhere = np.arange(50.0)
    assert region_sd_mm(0.05, 0.5, away * 0.2, weight, anywhere, 0.7) * REGION_90 > 35.0


def test_the_fewest_calyces_that_hold_the_one_observed():
    others, weight = np.array([2, 3, -1]), np.array([0.6, 0.3, 0.1])
    assert calyx_set(1, 0.97, others, weight) == [1]
    assert calyx_set(1, 0.5, others, weight) == [1, 2, 3]
    assert calyx_set(1, 0.0, others, weight) == [2, 3, -1]
    assert calyx_set(-1, 0.2, NOBODY.astype(int), NOBODY) == [-1]


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="anew_below < sure"):
        PlaceSettings(anew_below=0.95)
    with pytest.raises(InputError, match="4 weights"):
        PlaceSettings(weights=(1.0,))  # type: ignore[arg-type]
