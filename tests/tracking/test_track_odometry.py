"""A track that a robot tells of: where it is looked for, how far off it may be, and what leaps it makes."""

import numpy as np
import pytest
from flights import flight
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.tracking.certainty import track_weights
from ursnav_torch.tracking.relocalization import RelocalizationSettings, Relocated
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.robot.tether import TetherSettings
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import ChallengerSettings, FilterSettings, TrackSettings
from ursnav_torch.tracking.tracker import LOST, SEARCHING, TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid

#: Binds nobody.
LOOSE = TetherSettings(reach_mm=1e3)


def told_of(tracker: Tracker, renderer: RaycastRenderer, poses: np.ndarray, mm: float | None = 0.8) -> list[Tracked]:
    """A flight of which the robot tells so much insertion a picture; None: it tells nothing."""
    told = [None if mm is None else OdometryReading(mm * i) for i in range(len(poses))]
    pictures = [renderer.render(T).image for T in poses]
    return [tracker.step(p, i / 10, odometry=o) for i, (p, o) in enumerate(zip(pictures, told, strict=True))]


def test_a_shaft_that_is_pulled_is_looked_for_where_its_tip_came_by(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = FilterSettings(every_s=0.0)  # every picture is weighed
    tracker, poses, told = Tracker(vid, TrackSettings(filter=every)), flight(phantom, 2), []
    told_of(tracker, renderer, poses)
    follow_on = tracker._pursuit.follow
    monkeypatch.setattr(
        tracker._pursuit, "follow", lambda picture, anew: told.append(picture.told) or follow_on(picture, anew=anew)
    )
    back = len(poses) - 5
    tracker.step(renderer.render(poses[back]).image, len(poses) / 10, odometry=OdometryReading(0.8 * back))
    assert len(told) == 1 and len(told[0]) >= 2
    assert min(np.linalg.norm(T[:3, 3] - poses[back, :3, 3]) for T in told[0][1:]) < 2.5


def test_errors_are_those_of_tracks_that_a_robot_told_of_where_it_did(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer
) -> None:
    poses, weights = flight(phantom, 2), track_weights()
    told, alone = told_of(Tracker(vid), renderer, poses)[-1], told_of(Tracker(vid), renderer, poses, None)[-1]
    assert told.certainty is not None and alone.certainty is not None
    assert told.certainty.region_sd == weights.position_told.region_sd
    assert alone.certainty.region_sd == weights.position.region_sd != weights.position_told.region_sd


def test_a_leap_to_where_no_robot_leads_must_fit_better(vid: Vid, phantom: Kidney, renderer: RaycastRenderer) -> None:
    poses, s = flight(phantom, 2), ChallengerSettings()
    between = (s.reacquire_below + s.leap_above) / 2
    for led, leaps in ((False, False), (True, True)):
        tracker, far = Tracker(vid), flight(phantom, 5)[-1]
        told_of(tracker, renderer, poses)
        near = far if led else poses[-1]
        T = tracker._course.follow(far, between, len(poses) / 10, None, (near,))[0]
        assert bool(np.linalg.norm(T[:3, 3] - far[:3, 3]) < 1e-6) is leaps


def test_a_track_coasts_on_the_robots_word_past_pictures_of_where_it_was_not_driven(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer
) -> None:
    """Pictures show another place while the robot stands: for a second that is no place; then it is the track's."""
    wary = TrackSettings(challenger=ChallengerSettings(coast_below=1.1, persist_s=9.0), tether=LOOSE)
    tracker, way, far = Tracker(vid, wary), flight(phantom, 2), flight(phantom, 5)[-1]
    pictures = [renderer.render(T).image for T in [*way, *[way[-1]] * 5, *[far] * 20]]
    told = [OdometryReading(0.8 * min(i, len(way) - 1)) for i in range(len(pictures))]
    answers = [tracker.step(p, i / 10, odometry=o) for i, (p, o) in enumerate(zip(pictures, told, strict=True))]
    settled, after = answers[len(way) + 4], answers[len(way) + 5 :]
    assert settled.state == TRACKING and settled.T_kidney_camera is not None
    leapt = next(n for n, a in enumerate(after) if a.T_aligned is not None and near(a.T_aligned, far))
    for answer in after[leapt : leapt + 9]:
        assert answer.state == SEARCHING and answer.T_kidney_camera is not None
        assert near(answer.T_kidney_camera, settled.T_kidney_camera), "where the robot stands"
    assert after[-1].state == TRACKING and after[-1].T_kidney_camera is not None
    assert near(after[-1].T_kidney_camera, far), "in the end, as pictures go on to say so"


def test_pictures_that_are_coasted_past_teach_nothing(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    wary = TrackSettings(
        challenger=ChallengerSettings(coast_below=1.1, persist_s=9.0), filter=FilterSettings(every_s=0.0), tether=LOOSE
    )
    tracker, way, taught = Tracker(vid, wary), flight(phantom, 2), []
    told_of(tracker, renderer, way)
    for part, name in ((tracker._robot, "learn"), (tracker._robot, "mark"), (tracker._pattern, "learn")):
        monkeypatch.setattr(part, name, lambda *_, name=name: taught.append(name))
    monkeypatch.setattr(tracker._pattern, "tells", lambda *_: True)
    counts = {True: [], False: []}  # what a picture taught, by whether the track coasts past it
    far, stands = renderer.render(flight(phantom, 5)[-1]).image, OdometryReading(0.8 * (len(way) - 1))
    for n in range(25):
        before = len(taught)
        tracker.step(far, (len(way) + n) / 10, odometry=stands)
        counts[tracker._course.coasts].append(len(taught) - before)
    assert len(counts[True]) >= 8 and not any(counts[True])
    assert counts[False][-1] == 3, "as soon as it is followed it teaches: plays, the way in and the pattern"


@pytest.mark.parametrize(("score", "turned", "coasts"), [(0.7, False, True), (0.9, False, False), (0.7, True, False)])
def test_what_fits_well_or_is_only_turned_is_believed_at_once(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, score: float, turned: bool, coasts: bool
) -> None:
    poses, tracker = flight(phantom, 2), Tracker(vid)
    told_of(tracker, renderer, poses)
    T, here = flight(phantom, 5)[-1], tracker._course.predict(len(poses) / 10)
    assert here is not None
    if turned:
        T = here @ transform_from(Rotation.from_euler("x", 60, degrees=True).as_matrix(), np.zeros(3))
    found = tracker._course.follow(T, score, len(poses) / 10, None, (here,))[0]
    assert near(found, here if coasts else T)


def near(T: np.ndarray, other: np.ndarray) -> bool:
    """Whether two poses (4, 4) are one place."""
    return bool(are_near(T[None], other, 2.0, 20.0)[0])


@pytest.mark.parametrize("robot", [True, False])
def test_to_where_its_robot_did_not_bring_it_a_track_goes_only_once_good_pictures_insist(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, robot: bool
) -> None:
    """Pictures of a far calyx, each of which alone is aligned, and located as a still, without a doubt."""
    here, far = (flight(phantom, calyx)[-1] for calyx in (2, 5))
    tracker = Tracker(vid, TrackSettings(filter=FilterSettings(every_s=0.0)))
    joints = OdometryReading(5.0) if robot else None
    for n in range(5):
        tracker.step(renderer.render(here).image, n / 2, odometry=joints)
    assert tracker._tether.binds is robot
    goes_s: list[float] = []
    image = renderer.render(far).image
    for n in range(5, 14):
        answer = tracker.step(image, n / 2, odometry=joints)
        T = answer.T_kidney_camera
        if T is not None and near(T, far) and answer.state == TRACKING:
            goes_s.append((n - 5) / 2)
    release_s = tracker.settings.tether.release_s
    assert goes_s and (goes_s[0] >= release_s if robot else goes_s[0] < release_s)


def test_a_still_found_out_of_reach_of_the_robot_counts_for_nothing(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = TrackSettings(relocalization=RelocalizationSettings(above_mm=0.01))
    here, far = (flight(phantom, calyx)[-1] for calyx in (2, 5))
    for robot in (True, False):
        tracker, joints = Tracker(vid, settings), OdometryReading(5.0) if robot else None
        relocalizer = tracker._relocalizer
        assert relocalizer is not None
        monkeypatch.setattr(relocalizer, "locate", lambda image, seen: None)
        for n in range(4):
            tracker.step(renderer.render(here).image, n / 4, odometry=joints)
        monkeypatch.setattr(relocalizer, "locate", lambda image, seen: Relocated(far, 1e-3))
        answer = tracker.step(renderer.render(here).image, 2.0, odometry=joints)
        assert answer.evidence is None or answer.evidence.relocated is not robot
        assert answer.T_kidney_camera is not None and near(answer.T_kidney_camera, here) is robot


def test_a_sensor_tells_better_than_a_tether(vid: Vid, phantom: Kidney, renderer: RaycastRenderer) -> None:
    tracker, here = Tracker(vid), flight(phantom, 2)[-1]
    sensor = SensorReading(here[:3, 3], np.zeros(3), 0.5)
    bound = []
    for n in range(6):
        tracker.step(renderer.render(here).image, n / 4, sensor if n == 5 else None, OdometryReading(5.0))
        bound.append(tracker._tether.binds)
    assert bound[-2:] == [True, False]


def test_a_lost_track_is_looked_for_first_where_its_robot_leads(
    vid: Vid, phantom: Kidney, renderer: RaycastRenderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker, here, told = Tracker(vid), flight(phantom, 2)[-1], []
    for n in range(6):
        tracker.step(renderer.render(here).image, n / 4, odometry=OdometryReading(5.0))
    monkeypatch.setattr(tracker._test, "add", lambda *_: None)
    monkeypatch.setattr(type(tracker._test), "verdict", False)
    follow_on = tracker._pursuit.follow
    monkeypatch.setattr(
        tracker._pursuit, "follow", lambda picture, anew: told.append(picture.told) or follow_on(picture, anew=anew)
    )
    for n in range(6, 9):
        answer = tracker.step(renderer.render(here).image, n / 4, odometry=OdometryReading(5.0))
        assert answer.state == LOST and near(told[-1][0], here)
