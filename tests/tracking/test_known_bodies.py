"""What is known to lie before the wall hides it from a track."""

import numpy as np
import pytest
import torch
from flights import flight

from ursnav_torch.camera import Camera
from ursnav_torch.features import NO_EDGES, NO_MAPS, NOTHING_BEFORE, Features
from ursnav_torch.geometry import apply
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.tracking.pattern import KnownBodies
from ursnav_torch.tracking.tracker import TRACKING, Tracker
from ursnav_torch.vid import Vid


@pytest.fixture
def picture(lens: Camera) -> Features:
    shape = lens.height, lens.width
    return Features(NO_EDGES, NO_MAPS, np.zeros(shape, bool), torch.zeros(1, *shape), valid=NOTHING_BEFORE)


def left(bodies: KnownBodies, picture: Features, T: np.ndarray, lens: Camera) -> np.ndarray:
    """(H, W) what is valid."""
    mask = torch.from_numpy(lens.pixel_rays()[1].astype(np.float32))
    return np.asarray(bodies.left_out(picture, T, lens, mask).valid)


def test_a_ball_ahead_hides_what_lies_behind_it_and_a_little_beside(
    phantom: Kidney, phantom_lumen: LumenDistance, picture: Features, lens: Camera
) -> None:
    bodies, T = KnownBodies(phantom_lumen), flight(phantom, 2)[4]
    bodies.balls_mm = np.array([[*apply(T, np.array([[0.0, 0.0, 4.0]]))[0], 1.0]])
    valid = left(bodies, picture, T, lens)
    rays, inside = lens.pixel_rays()
    angle = np.arccos(np.clip(rays[..., 2], -1, 1))
    assert not valid[inside & (angle < np.arcsin(0.25))].any()
    assert valid[inside & (angle > 1.2 * np.arcsin(0.25) + 0.06)].all() and not valid[~inside].any()


def test_what_was_invalid_stays_so(phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera) -> None:
    bodies, T, shape = KnownBodies(phantom_lumen), flight(phantom, 2)[4], (lens.height, lens.width)
    told = Features(NO_EDGES, NO_MAPS, np.zeros(shape, bool), torch.zeros(1, *shape), valid=torch.zeros(shape))
    bodies.balls_mm = np.array([[*apply(T, np.array([[0.0, 0.0, 4.0]]))[0], 1.0]])
    assert not left(bodies, told, T, lens).any()


@pytest.mark.parametrize("where", ["behind a wall", "far away", "around the lens"])
def test_a_ball_that_is_out_of_sight_hides_nothing(
    phantom: Kidney, phantom_lumen: LumenDistance, picture: Features, lens: Camera, where: str
) -> None:
    bodies, T = KnownBodies(phantom_lumen), flight(phantom, 2)[-1]
    at = {"behind a wall": phantom.calyces[5].tip_mm, "far away": T[:3, 3] + 60.0, "around the lens": T[:3, 3]}[where]
    bodies.balls_mm = np.array([[*at, 1.0]])
    assert left(bodies, picture, T, lens).size == 0


def test_a_track_goes_on_past_a_known_stone_and_a_lost_one_asks_for_none(vid: Vid, phantom: Kidney, renderer) -> None:
    tracker, asked = Tracker(vid), list[np.ndarray]()
    tracker.known.left_out = lambda features, T, camera, mask: asked.append(T) or features  # type: ignore[method-assign]
    poses = flight(phantom, 2)
    answers = [tracker.step(renderer.render(T).image, i / 10) for i, T in enumerate(poses)]
    tracked = sum(a.state == TRACKING for a in answers[:-1])
    assert 0 < len(asked) == tracked < len(poses)
    assert np.linalg.norm(asked[-1][:3, 3] - poses[-2][:3, 3]) < 2.0
