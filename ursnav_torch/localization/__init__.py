"""From a picture to a place in the kidney: calyx, confidence, pose."""

from ursnav_torch.localization.ambiguity import LookAlikes, find_look_alikes
from ursnav_torch.localization.answers import Candidate, Location
from ursnav_torch.localization.learn import Query, learn_confidence, simulated_queries
from ursnav_torch.localization.locate import Localizer
from ursnav_torch.localization.matches import MATCH_COLUMNS, find_images, locate_files, match_row
from ursnav_torch.localization.metrics import (
    PoseErrors,
    frames_to_loss,
    jitter_mm,
    pose_errors,
    success,
    trajectory_error_mm,
    write_tum,
)
from ursnav_torch.localization.pnp import EdgePnp, solve_pnp
from ursnav_torch.localization.refine import Refined, RefinementSettings, Refiner
from ursnav_torch.localization.settings import LocalizationSettings, default_matching

__all__ = [
    "MATCH_COLUMNS",
    "Candidate",
    "EdgePnp",
    "LocalizationSettings",
    "Localizer",
    "Location",
    "LookAlikes",
    "PoseErrors",
    "Query",
    "Refined",
    "RefinementSettings",
    "Refiner",
    "default_matching",
    "find_images",
    "find_look_alikes",
    "frames_to_loss",
    "jitter_mm",
    "learn_confidence",
    "locate_files",
    "match_row",
    "pose_errors",
    "simulated_queries",
    "solve_pnp",
    "success",
    "trajectory_error_mm",
    "write_tum",
]
