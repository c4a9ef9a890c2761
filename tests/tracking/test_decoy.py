"""The mirrored picture that a track's fit is held against while the kidney is in doubt."""

from dataclasses import replace

import numpy as np
import torch
from flights import flight

from ursnav_torch.camera import Camera
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.decoy import mirrored
from ursnav_torch.tracking.settings import OwnKidneySettings, TrackSettings
from ursnav_torch.tracking.tracker import LOST, TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid


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


def test_pictures_of_the_mirrored_kidney_are_believed_without_a_decoy_and_refused_with_it(
    vid: Vid, renderer: RaycastRenderer, phantom: Kidney
) -> None:
    poses = np.concatenate([flight(phantom, calyx)[::-1] for calyx in (0, 1)])
    never = TrackSettings(own_kidney=OwnKidneySettings(doubt_below=-99.0))
    taken_in = [a.state == TRACKING for a in seen_by(Tracker(vid, never), renderer, poses, mirror=True)]
    assert np.mean(taken_in) > 0.5, "the mirrored kidney must be one that is easily believed"
    answers = seen_by(Tracker(vid), renderer, poses, mirror=True)
    assert answers[-1].state == LOST and TRACKING not in [a.state for a in answers]
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
        tracker._mirrored(found) for T in (poses[0], poses[-1]) if (found := tracker.extract(renderer.render(T).image))
    )
    fresh = tracker._decoy.score(first, 0.0)
    for begin_s, forget in ((0.0, tracker.reset), (100.0, lambda: None)):
        tracker._decoy.score(there, begin_s)
        forget()
        assert tracker._decoy.score(first, begin_s + 10.0) == fresh
