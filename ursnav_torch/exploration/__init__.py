"""What of the kidney was seen, what is next, and the way there."""

from ursnav_torch.exploration.coverage import CoverageSettings
from ursnav_torch.exploration.route import ScopeLimits
from ursnav_torch.exploration.settings import ExplorationSettings

__all__ = ["CoverageSettings", "ExplorationSettings", "ScopeLimits"]
