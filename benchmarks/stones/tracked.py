"""The tracker's poses for a flight past stones, kept until the code that finds them changes."""

from pathlib import Path

import numpy as np

from benchmarks.shared.fingerprints import sources
from benchmarks.stones.flights import StoneFlight, stone_vid
from benchmarks.stones.scores import Poses
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.tracker import Tracker

_ROOMS = ("features", "matching", "search", "alignment", "localization", "tracking")


def tracked_poses(flight: StoneFlight, views: int, work: Path) -> Poses:
    """Poses by number of the picture, None where the track has no settled one; the robot is heard."""
    path = flight.folder / f"track_{views}_{sources(_ROOMS)[:10]}.npz"
    if not path.exists():
        tracker = Tracker(stone_vid(flight, views, work))
        T, sd = np.full((len(flight.t_s), 4, 4), np.nan), np.zeros((len(flight.t_s), 2))
        for i, image in enumerate(flight.images()):
            found = tracker.step(image, float(flight.t_s[i]), odometry=OdometryReading(*flight.odometry[i].tolist()))
            if found.is_settled and found.certainty is not None and found.T_kidney_camera is not None:
                T[i] = found.T_kidney_camera
                sd[i] = found.certainty.position_sd_mm, np.radians(found.certainty.direction_sd_deg)
        np.savez(path, T=T, sd=sd)
    with np.load(path) as kept:
        T, sd = kept["T"], kept["sd"]
    return lambda i: None if np.isnan(T[i, 0, 0]) else (T[i], (float(sd[i, 0]), float(sd[i, 1])))
