"""From a picture to a place in the kidney: calyx, confidence, pose."""

from ursnav_torch.localization.ambiguity import LookAlikes, find_look_alikes
from ursnav_torch.localization.learn import Query, learn_confidence, simulated_queries
from ursnav_torch.localization.locate import (
    Candidate,
    LocalizationSettings,
    Localizer,
    Location,
    default_matching,
)
from ursnav_torch.localization.matches import MATCH_COLUMNS, find_images, locate_files, match_row

__all__ = [
    "MATCH_COLUMNS",
    "Candidate",
    "LocalizationSettings",
    "Localizer",
    "Location",
    "LookAlikes",
    "Query",
    "default_matching",
    "find_images",
    "find_look_alikes",
    "learn_confidence",
    "locate_files",
    "match_row",
    "simulated_queries",
]
