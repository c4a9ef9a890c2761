"""What becomes of a track's answers besides rows: the wall that they saw."""

import numpy as np
from painted import painted_rows, upper_half

from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.runs.track_rows import track_rows
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid


def test_wall_that_a_mask_hides_is_not_painted(vid: Vid, picture: np.ndarray) -> None:
    tracker, T = Tracker(vid), vid.T_kidney_camera[5]
    tracker.narrow(upper_half(picture.shape))
    coverage = Coverage(vid.kidney, vid.camera, tracker.lumen)
    answers = [(Moment(i, i / 10, picture, str(i)), Tracked(TRACKING, T, 0, 1.0, 1.0, 1.0, 0.0)) for i in range(20)]
    assert len(list(track_rows(tracker, answers, coverage))) == 20
    rows = painted_rows(coverage, vid.camera, T)
    assert len(rows) > 20 and rows.max() < len(picture) / 2
