"""From a picture to a place in the kidney: calyx, confidence, pose."""

from ursnav_torch.localization.locate import (
    Candidate,
    LocalizationSettings,
    Localizer,
    Location,
    default_matching,
    rolled,
)
from ursnav_torch.localization.matches import MATCH_COLUMNS, find_images, locate_files, match_row

__all__ = ["MATCH_COLUMNS", "Candidate", "LocalizationSettings", "Localizer", "Location", "default_matching", "find_images", "locate_files", "match_row", "rolled"]
