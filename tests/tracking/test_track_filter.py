"""Following the scope through simulated flights: it holds on, bridges, finds back, and refuses another kidney."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from flights import flight

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import ThesisSettings
from ursnav_torch.geometry import rotation_angle
from ursnav_torch.kidney import Kidney, make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.follow import Instruments, Moment, Source, follow_source
from ursnav_torch.tracking.motion import Hypotheses, Since
from ursnav_torch.tracking.pursuit import expected
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.robot.tether import TetherSettings
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, FilterSettings, OwnKidneySettings, TrackSettings
from ursnav_torch.tracking.tracker import LOST, SEARCHING, TRACKING, Tracked, Tracker
from ursnav_torch.vid import PlanSettings, Vid, build_vid


@pytest.fixture(scope="module")
def tracker(vid: Vid) -> Tracker:
    return Tracker(vid)


@pytest.fixture
def fresh(tracker: Tracker) -> Iterator[Tracker]:
    tracker.reset()
    yield tracker


def follow(tracker: Tracker, renderer: RaycastRenderer, poses: np.ndarray, start: int = 0) -> list[Tracked]:
    return [tracker.step(renderer.render(T).image, (start + i) / 10) for i, T in enumerate(poses)]


def off_mm(answers: list[Tracked], poses: np.ndarray) -> np.ndarray:
    return np.array(
        [
            np.inf if a.T_kidney_camera is None else np.linalg.norm(a.T_kidney_camera[:3, 3] - T[:3, 3])
            for a, T in zip(answers, poses, strict=True)
        ]
    )


def test_a_flight_into_a_calyx_is_followed(fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer) -> None:
    poses = flight(phantom, 2, roll=0.3)
    answers = follow(fresh, renderer, poses)
    settled = off_mm(answers, poses)[9:]  # within a second
    assert {a.state for a in answers[9:]} == {TRACKING}
    assert np.median(settled) < 0.6 and settled.max() < 2.0
    last = answers[-1]
    assert last.T_kidney_camera is not None
    assert float(rotation_angle(last.T_kidney_camera, poses[-1])) < np.radians(10)
    assert last.calyx == 2 and last.confidence > 0.8


def test_the_same_pictures_give_the_same_answers(fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer) -> None:
    poses = flight(phantom, 1)[:5]
    first = off_mm(follow(fresh, renderer, poses), poses)
    fresh.reset()
    np.testing.assert_array_equal(first, off_mm(follow(fresh, renderer, poses), poses))


def test_white_pictures_are_bridged_but_not_for_ever(
    fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer, lens: Camera
) -> None:
    poses, tracker = flight(phantom, 2), Tracker(fresh.vid)
    follow(tracker, renderer, poses)
    white = np.full((lens.height, lens.width), 255, np.uint8)
    answers = [tracker.step(white, (len(poses) + i) / 10) for i in range(15)]
    assert answers[2].state == TRACKING and off_mm(answers[2:3], poses[-1:])[0] < 3.0
    assert np.isnan(answers[2].score)
    assert answers[6].state == SEARCHING, "a pose that nobody has seen for so long may be anywhere near"
    assert answers[6].T_kidney_camera is not None and not answers[6].is_settled
    confidence = [a.confidence for a in answers[:9]]
    assert confidence == sorted(confidence, reverse=True)
    assert answers[-1].state == SEARCHING and answers[-1].T_kidney_camera is None
    again = follow(tracker, renderer, poses[-3:], start=len(poses) + 15)
    assert again[-1].state == TRACKING and off_mm(again, poses[-3:])[-1] < 2.0


def test_in_the_dark_a_track_goes_where_the_robot_goes(
    fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer, lens: Camera
) -> None:
    """What is pushed while nothing can be seen is where the scope is found afterwards."""
    poses = flight(phantom, 1)
    white = np.full((lens.height, lens.width), 255, np.uint8)
    away = {}
    for told in (True, False):
        fresh.reset()
        for i, T in enumerate(poses[:8]):
            fresh.step(renderer.render(T).image, i / 10, odometry=OdometryReading(0.8 * i) if told else None)
        for i in range(8, 12):
            seen = fresh.step(white, i / 10, odometry=OdometryReading(0.8 * i) if told else None)
        assert seen.T_kidney_camera is not None
        away[told] = np.linalg.norm(seen.T_kidney_camera[:3, 3] - poses[11, :3, 3])
    assert away[True] < min(1.0, away[False])


def test_a_scope_put_elsewhere_is_found_within_two_seconds(
    fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer
) -> None:
    follow(fresh, renderer, flight(phantom, 2))
    there = np.repeat(flight(phantom, 5)[-1:], 20, axis=0)
    answers = follow(fresh, renderer, there, start=20)
    assert off_mm(answers, there)[-1] < 1.5
    assert answers[-1].state == TRACKING and answers[-1].calyx == 5


def test_what_motion_forbids_is_held_against_a_pose(fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer) -> None:
    poses = flight(phantom, 2)
    settings = (fresh.settings.challenger, fresh.lumen)
    assert not expected(None, None, *settings)(poses).any()  # before the first picture nothing is known
    follow(fresh, renderer, poses)
    assert fresh._before is not None
    since = Since(fresh._before, 0.1, fresh.settings.motion)
    near, far, elsewhere = expected(since, None, *settings)(np.stack([poses[-1], poses[-8], flight(phantom, 5)[-1]]))
    assert near == 0.0 > far > elsewhere >= -fresh.settings.challenger.score_step
    sensor = SensorReading(poses[-8, :3, 3], np.zeros(3), 0.5)
    told = expected(since, sensor, *settings)(np.stack([poses[-1], poses[-8]]))
    assert told[1] > told[0]


def test_the_sensor_tells_where_to_look(fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer) -> None:
    pose, offset = flight(phantom, 3)[-1], np.array([0.0, 1.2, -4.0])
    sensor = SensorReading(pose[:3, :3] @ offset + pose[:3, 3], offset, 0.5)
    image = renderer.render(pose).image
    answers = [fresh.step(image, i / 10, sensor) for i in range(5)]
    assert off_mm(answers[-1:], pose[None])[0] < 0.8


def test_the_sensor_is_fused_into_the_smoothed_pose(fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer) -> None:
    """A reading a millimeter aside draws the answer there, and the aligned pose less."""
    poses = flight(phantom, 2)
    moments = [Moment(i, i / 10, renderer.render(T).image, str(i)) for i, T in enumerate(poses)]
    source, drawn, aligned = Source(lambda: iter(moments), len(moments), "pictures"), {}, {}
    for sigma in (None, 0.4):

        def aside(moment: Moment, sigma: float | None = sigma) -> SensorReading | None:
            T = poses[moment.frame]
            return None if sigma is None else SensorReading(T[:3, 3] + T[:3, 0], np.zeros(3), sigma)

        fresh.reset()
        answers = [tracked for _, tracked in follow_source(fresh, source, Instruments(aside))]
        assert {a.state for a in answers[-3:]} == {TRACKING}
        drawn[sigma], aligned[sigma] = (
            np.mean([(T_found[:3, 3] - T[:3, 3]) @ T[:3, 0] for T_found, T in zip(found[-3:], poses[-3:], strict=True)])
            for found in ([a.T_kidney_camera for a in answers], [a.T_aligned for a in answers])
        )
    assert 0.3 < drawn[0.4] - drawn[None] < 1.1
    assert drawn[0.4] - drawn[None] > aligned[0.4] - aligned[None] + 0.1


def test_confidence_is_what_the_hypotheses_say_of_the_calyx(
    fresh: Tracker, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of it is their vote: where all of them observe another calyx, half is left."""
    poses = flight(phantom, 2)
    sure = follow(fresh, renderer, poses)[-1]
    elsewhere = fresh.vid.T_kidney_camera[fresh.vid.calyx == 5]
    update = type(fresh._filter).update

    def contradicted(*given: object) -> tuple[Hypotheses, np.ndarray]:
        found, fits = update(*given)
        there = Hypotheses(elsewhere, fresh.lumen.to_calyces(elsewhere[:, :3, 3]), np.full(len(elsewhere), 1e-3))
        both = [
            np.concatenate([getattr(found, name), getattr(there, name)]) for name in ("T_kidney_camera", "to_tips_mm")
        ]
        weight = np.concatenate([1e-9 * found.weight, there.weight])
        return Hypotheses(both[0], both[1], weight / weight.sum()), np.append(fits, np.zeros(len(elsewhere)))

    monkeypatch.setattr(type(fresh._filter), "update", contradicted)
    unsure = fresh.step(renderer.render(poses[-1]).image, len(poses) / 10 + fresh.settings.filter.every_s)
    assert sure.confidence > 0.9 and unsure.state == TRACKING and unsure.calyx == sure.calyx == 2
    assert unsure.confidence == pytest.approx(0.5, abs=0.05)
    black = fresh.step(np.zeros_like(renderer.render(poses[-1]).image), len(poses) / 10 + 0.4)
    assert black.T_kidney_camera is not None and 0.3 < black.confidence < 0.5, "nobody is surer of what is not seen"


@pytest.mark.slow
def test_another_kidney_ends_lost(vid: Vid, lens: Camera, plan: PlanSettings, phantom: Kidney) -> None:
    other = make_phantom_kidney(7, calyces=6)
    renderer, tracker = RaycastRenderer(other.mesh, lens), Tracker(vid)
    poses = np.concatenate([flight(other, c)[::-1] for c in range(3)])
    states = [a.state for a in follow(tracker, renderer, poses)]
    assert states[-1] == LOST
    assert states.count(TRACKING) <= 0.02 * len(states)


def test_features_without_maps_are_refused(phantom: Kidney, lens: Camera, plan: PlanSettings, tmp_path: Path) -> None:
    few = PlanSettings(views_per_calyx=2, passage_views=2)
    thesis = build_vid(phantom, lens, ThesisSettings(), RaycastRenderer, few, tmp_path / "thesis", workers=1)
    with pytest.raises(InputError, match="features=default"):
        Tracker(thesis)


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(InputError, match="best_fitting < hypotheses"):
        FilterSettings(best_fitting=100)


@pytest.mark.parametrize(("told", "well"), [(True, 1.1), (True, 0.5), (False, 1.1)])
def test_a_place_where_the_scope_was_not_driven_is_believed_by_its_own_evidence_alone(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, told: bool, well: float
) -> None:
    """Pictures of another calyx while the robot says that nothing moved: where they fit badly the track starts anew."""
    late = OwnKidneySettings(after_leap=-2.5)  # so that it takes more than two pictures
    at_once, loose = ChallengerSettings(challenge_below=well, coast_s=0.0), TetherSettings(reach_mm=1e3)
    tracker = Tracker(vid, TrackSettings(challenger=at_once, own_kidney=late, tether=loose))
    way = flight(phantom, 2)
    for i, T in enumerate([*way, *[way[-1]] * 12]):  # at its end it is settled
        inserted = OdometryReading(0.8 * min(i, len(way) - 1))
        settled = tracker.step(renderer.render(T).image, i / 10, odometry=inserted if told else None)
    assert settled.state == TRACKING
    there = flight(phantom, 5)[-1]
    still = inserted if told else None
    answers = [tracker.step(renderer.render(there).image, (i + n) / 10, odometry=still) for n in range(1, 21)]
    leapt = int(np.argmax([a.T_aligned is not None and np.allclose(a.T_aligned, there, atol=0.7) for a in answers]))
    anew = told and well > 1
    for answer in answers[leapt : leapt + 3]:
        assert (answer.state == SEARCHING and answer.T_kidney_camera is None) == anew
    assert answers[-1].state == TRACKING and answers[-1].calyx == 5
