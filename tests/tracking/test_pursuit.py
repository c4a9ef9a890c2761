"""The track at hand and its challenger: what is tried next, and when another place takes over."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from flights import ahead_by

from ursnav_torch.alignment import Refined
from ursnav_torch.alignment.light import AT_CAMERA
from ursnav_torch.geometry import look_along
from ursnav_torch.scaling import scaled
from ursnav_torch.tracking.motion import Hypotheses
from ursnav_torch.tracking.pursuit import Pursuit, Weighed
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, FilterSettings

#: Drawing, start and hypotheses tried: nothing here looks at them.
NOT_ASKED = (None, None, None)
HERE = look_along(np.zeros(3), np.array([0.0, 0.0, 1.0]))
THERE = look_along(np.array([30.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
FAR = look_along(np.array([0.0, 40.0, 0.0]), np.array([1.0, 0.0, 0.0]))


class Scores:
    """A refiner that moves nothing: a pose scores what its place is given, and the best of those tried wins."""

    def __init__(self, here: float, there: float = 0.0) -> None:
        self.here, self.there = here, there
        self.asked: list[list[np.ndarray]] = []

    def refine(self, features: object, candidates: Sequence[np.ndarray], *_: object) -> Refined:
        self.asked.append(list(candidates))
        scores = [self._score(T) for T in candidates]
        best = int(np.argmax(scores))
        found = (candidates[best], scores[best], best, 1, AT_CAMERA, *NOT_ASKED, np.array([scores[best]]), None)
        return Refined(*found)  # type: ignore[arg-type]

    def _score(self, T: np.ndarray) -> float:
        for place, score in ((HERE, self.here), (THERE, self.there)):
            if np.linalg.norm(T[:3, 3] - place[:3, 3]) < 5.0:
                return score
        return 0.1


def picture(best: np.ndarray, *others: np.ndarray, sensor: SensorReading | None = None) -> Weighed:
    """What the filter makes of a picture: hypotheses, the first of them most probable and best fitting."""
    T = np.stack([best, *others])
    weight = np.array([0.9] + [0.1 / max(len(others), 1)] * len(others))
    found = Hypotheses(T, np.zeros((len(T), 1)), weight / weight.sum())
    return Weighed(None, found, np.linspace(1.5, 1.0, len(T)), lambda poses: np.zeros(len(poses)), sensor)  # type: ignore[arg-type]


def followed(scores: Scores, scale: float = 1.0) -> Pursuit:
    """A track at `HERE`, in a kidney of that scale."""
    settings = scaled(ChallengerSettings(), scale), scaled(FilterSettings(), scale)
    pursuit = Pursuit(scores, *settings)  # type: ignore[arg-type]
    pursuit.follow(picture(HERE, FAR), anew=True)
    return pursuit


def at(refined: Refined, place: np.ndarray) -> bool:
    return bool(np.linalg.norm(refined.T_kidney_camera[:3, 3] - place[:3, 3]) < 5.0)


def test_a_step_deeper_and_one_less_deep_are_tried_in_turn() -> None:
    """Depth is what alignment tells least."""
    scores = Scores(0.8)
    pursuit, slides = followed(scores), []
    for _ in range(4):
        pursuit.follow(picture(HERE, FAR), anew=False)
        tried = np.array([T[:3, 3] for T in scores.asked[-1]])
        slides.append({round(float(z)) for x, y, z in tried if abs(x) + abs(y) < 1e-9 and abs(z) > 1e-9})
    assert slides[0] != slides[1]
    # whichever of equals wins keeps its place, so that the slides go on from there
    assert slides in ([{-2}, {2}, {-2}, {2}], [{2}, {-2}, {2}, {-2}])


def test_slides_are_millimeters_of_anatomy() -> None:
    scores = Scores(0.8)
    followed(scores, scale=2.0).follow(picture(HERE, FAR), anew=False)
    assert 4 in {round(abs(float(T[2, 3]))) for T in scores.asked[-1]}


def test_where_the_last_step_led_is_tried_first() -> None:
    scores = Scores(0.8)
    pursuit = followed(scores)
    pursuit.follow(picture(ahead_by(HERE, 1.0), FAR), anew=True)
    scores.asked.clear()
    pursuit._incumbent = type(pursuit._incumbent)(  # as if the scope had gone on by a millimeter in this picture
        Refined(ahead_by(HERE, 1.0), 0.8, 0, 1, AT_CAMERA, *NOT_ASKED, np.array([0.8]), None),  # type: ignore[arg-type]
        Refined(HERE, 0.8, 0, 1, AT_CAMERA, *NOT_ASKED, np.array([0.8]), None),  # type: ignore[arg-type]
    )
    pursuit.follow(picture(ahead_by(HERE, 1.0), FAR), anew=False)
    np.testing.assert_allclose(scores.asked[0][0], ahead_by(HERE, 2.0), atol=1e-9)
    np.testing.assert_allclose(scores.asked[0][2], ahead_by(HERE, 1.0), atol=1e-9)


def flat(poses: np.ndarray) -> np.ndarray:
    """Motion that says nothing."""
    return np.zeros(len(poses))


def test_a_settled_track_goes_on_from_where_motion_leads_alone() -> None:
    scores = Scores(0.8)
    pursuit = followed(scores)
    assert not pursuit.settled and pursuit.go_on(None, flat) is None, "nothing bore it out yet"  # type: ignore[arg-type]
    pursuit.follow(picture(HERE, FAR), anew=False)
    assert pursuit.settled
    found = pursuit.go_on(None, flat)  # type: ignore[arg-type]
    assert found is not None and at(found, HERE)
    assert len(scores.asked[-1]) == 3 < ChallengerSettings().starts


def test_a_settled_track_that_is_aligned_worse_than_of_late_has_to_be_looked_at() -> None:
    scores = Scores(0.8)
    pursuit = followed(scores)
    pursuit.follow(picture(HERE, FAR), anew=False)
    scores.here = 0.8 - ChallengerSettings().usual_drop + 0.01
    assert pursuit.go_on(None, flat) is not None  # type: ignore[arg-type]
    scores.here = 0.8 - 2 * ChallengerSettings().usual_drop
    assert pursuit.go_on(None, flat) is None  # type: ignore[arg-type]
    low = Scores(ChallengerSettings().enough_above - 0.01)
    pursuit = followed(low)
    pursuit.follow(picture(HERE, FAR), anew=False)
    assert pursuit.go_on(None, flat) is None, "badly aligned all the time"  # type: ignore[arg-type]


def test_what_was_aligned_in_vain_is_not_aligned_again() -> None:
    """The look that follows tries the other starts alone, goes on from the better, and slides as often as ever."""
    scores = Scores(0.8)
    pursuit = followed(scores)
    near = ahead_by(HERE, -1.5)
    pursuit.follow(picture(HERE, near), anew=False)
    scores.here = 0.6
    assert pursuit.go_on(None, flat) is None  # type: ignore[arg-type]
    in_vain = scores.asked[-1]
    scores.asked.clear()
    found = pursuit.follow(picture(HERE, near), anew=False)
    again = [T for asked in scores.asked[:1] for T in asked]
    assert len(in_vain) == 3 and at(found, HERE) and found.score == 0.6
    assert all(np.linalg.norm(T[:3, 3] - tried[:3, 3]) > 0.5 for T in again for tried in in_vain)
    pursuit.follow(picture(HERE, near), anew=False)
    assert len(scores.asked[-1]) >= 3, "in the next picture all starts are tried"


def test_a_track_that_the_filter_does_not_bear_out_is_not_settled() -> None:
    pursuit = followed(Scores(0.8))
    pursuit.follow(picture(HERE, FAR), anew=False)
    pursuit.follow(picture(FAR, HERE), anew=False)
    assert not pursuit.settled and pursuit.go_on(None, flat) is None  # type: ignore[arg-type]


def test_a_challenger_takes_over_after_being_better_for_a_while_not_at_once() -> None:
    """Two full steps a picture at most, and three are needed."""
    scores = Scores(0.5, there=0.95)
    pursuit, found, trusted = followed(scores), [], []
    for _ in range(2):
        found.append(at(pursuit.follow(picture(THERE, HERE), anew=False), THERE))
        trusted.append(pursuit.trusted)
    assert found == [False, True]
    assert trusted == [pytest.approx(1 / 3), 1.0]


def test_a_slightly_better_challenger_needs_longer_and_a_worse_one_never_takes_over() -> None:
    def pictures_until_taken(gain: float) -> int | None:
        pursuit = followed(Scores(0.5, there=0.5 + gain))
        taken = [at(pursuit.follow(picture(THERE, HERE), anew=False), THERE) for _ in range(20)]
        return taken.index(True) + 1 if any(taken) else None

    assert (pictures_until_taken(0.11), pictures_until_taken(0.055)) == (3, 6)
    assert pictures_until_taken(-0.01) is None


def test_a_challenger_that_fades_is_forgotten_step_by_step() -> None:
    scores = Scores(0.7, there=0.85)
    pursuit = followed(scores)
    pursuit.follow(picture(THERE, HERE), anew=False)
    doubted = pursuit.trusted
    scores.there = 0.65
    for _ in range(3):
        pursuit.follow(picture(THERE, HERE), anew=False)
    assert doubted == pytest.approx(0.5) and pursuit.trusted == pytest.approx(1.0)


def test_the_sensor_speaks_for_the_place_that_it_is_near() -> None:
    near_own = SensorReading(HERE[:3, 3], np.zeros(3), 1.0)
    near_other = SensorReading(THERE[:3, 3], np.zeros(3), 1.0)
    taken = []
    for sensor in (None, near_own, near_other):
        pursuit = followed(Scores(0.5, there=0.615))
        shown = [pursuit.follow(picture(THERE, HERE, sensor=sensor), anew=False) for _ in range(8)]
        taken.append([at(refined, THERE) for refined in shown].index(True) if at(shown[-1], THERE) else None)
    assert taken == [2, None, 1]


def test_a_shaky_track_is_looked_for_anew_and_a_good_pose_is_remembered() -> None:
    scores = Scores(0.8)
    pursuit = followed(scores)
    pursuit.follow(picture(HERE, FAR), anew=False)
    scores.here = 0.2
    pursuit.follow(picture(HERE, FAR), anew=False)
    scores.asked.clear()
    pursuit.follow(picture(FAR, THERE), anew=False)
    tried = np.array([T[:3, 3] for T in scores.asked[0]])
    for place in (HERE, FAR, THERE):
        assert np.linalg.norm(tried - place[:3, 3], axis=1).min() < 1e-9


def test_a_reset_forgets_the_track() -> None:
    scores = Scores(0.8)
    pursuit = followed(scores)
    pursuit.follow(picture(HERE, FAR), anew=False)
    pursuit.reset()
    scores.asked.clear()
    pursuit.follow(picture(THERE, FAR), anew=False)
    assert all(np.linalg.norm(T[:3, 3] - HERE[:3, 3]) > 5.0 for T in scores.asked[0])


def test_a_track_that_slips_is_looked_for_around_where_it_was() -> None:
    """Poses are drawn there once it is aligned worse than of late, and not before; wider from picture to picture."""
    scores = Scores(0.9)
    pursuit = followed(scores)
    asked = len(scores.asked)
    pursuit.follow(picture(HERE, FAR), anew=False)
    assert len(scores.asked) == asked + 1
    scores.here = 0.5
    spread = []
    for _ in range(2):
        pursuit.follow(picture(HERE, FAR), anew=False)
        (drawn,) = [tried for tried in scores.asked[-3:] if len(tried) == ChallengerSettings().catches]
        spread.append(np.std([T[:3, 3] - HERE[:3, 3] for T in drawn]))
    assert 0.3 < spread[0] / ChallengerSettings().catch_mm < 2
    pursuit.catches = 0
    asked = len(scores.asked)
    pursuit.follow(picture(HERE, FAR), anew=False)
    assert all(len(tried) != ChallengerSettings().catches for tried in scores.asked[asked:])


def told(best: np.ndarray, *places: np.ndarray) -> Weighed:
    """A picture of which a robot told where the camera may be."""
    return replace(picture(best, FAR), told=places)


def test_where_a_robot_puts_the_camera_is_tried_too() -> None:
    """Beside where the track leads, and, once it is looked for anew, before anything else."""
    scores = Scores(0.8)
    carried, sprung = ahead_by(HERE, 6.0), ahead_by(HERE, -7.0)
    pursuit = followed(scores)
    scores.asked.clear()
    pursuit.follow(told(HERE, carried, sprung), anew=False)
    assert any(T is carried for T in scores.asked[0]) and any(T is sprung for T in scores.asked[0])
    scores.asked.clear()
    pursuit.follow(told(HERE, carried, sprung), anew=True)
    assert scores.asked[0][0] is carried and scores.asked[0][1] is sprung


def test_a_track_that_slips_is_looked_for_around_where_the_shafts_way_leads_too() -> None:
    scores, sprung = Scores(0.9), ahead_by(HERE, 60.0)
    pursuit = followed(scores)
    pursuit.follow(picture(HERE, FAR), anew=False)
    scores.here = 0.5
    pursuit.follow(told(HERE, HERE, sprung), anew=False)
    (drawn,) = [tried for tried in scores.asked[-3:] if len(tried) == ChallengerSettings().catches]
    near = [np.linalg.norm(T[:3, 3] - sprung[:3, 3]) < 20 for T in drawn]
    assert near == [False, True] * (len(near) // 2)
