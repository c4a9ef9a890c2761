"""From a picture to a place in the kidney: calyx, confidence, pose."""

from ursnav_torch.localization.locate import (
    Candidate,
    LocalizationSettings,
    Localizer,
    Location,
    default_matching,
    rolled,
)

__all__ = ["Candidate", "LocalizationSettings", "Localizer", "Location", "default_matching", "rolled"]
