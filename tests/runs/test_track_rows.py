"""What becomes of a track's answers besides rows: the wall that they saw."""

import numpy as np

from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.runs.track_rows import track_rows
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid


def test_wall_that_a_mask_hides_is_not_painted(vid: Vid, picture: np.ndarray) -> None:
    tracker, T, upper = Tracker(vid), vid.T_kidney_camera[5], np.zeros(picture.shape, bool)
    upper[: len(upper) // 2] = True
    tracker.narrow(upper)
    coverage = Coverage(vid.kidney, vid.camera, tracker.lumen)
    answers = [(Moment(i, i / 10, picture, str(i)), Tracked(TRACKING, T, 0, 1.0, 1.0, 1.0, 0.0)) for i in range(20)]
    assert len(list(track_rows(tracker, answers, coverage))) == 20
    seen = coverage.patches.center_mm[coverage.seen()]
    pixels, _ = vid.camera.project((seen - T[:3, 3]) @ T[:3, :3])
    assert len(seen) > 20 and pixels[:, 1].max() < len(upper) / 2
