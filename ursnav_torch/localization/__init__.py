"""From a picture to a place in the kidney: calyx, confidence, pose."""

from ursnav_torch.localization.ambiguity import LookAlikes, find_look_alikes
from ursnav_torch.localization.answers import Candidate, Location
from ursnav_torch.localization.learn import LEARNED_FROM, Query, learn_confidence, queries_from, simulated_queries
from ursnav_torch.localization.locate import Localizer
from ursnav_torch.localization.settings import LocalizationSettings
from ursnav_torch.search import SearchSettings, default_matching

__all__ = [
    "LEARNED_FROM",
    "Candidate",
    "LocalizationSettings",
    "Localizer",
    "Location",
    "LookAlikes",
    "Query",
    "SearchSettings",
    "default_matching",
    "find_look_alikes",
    "learn_confidence",
    "queries_from",
    "simulated_queries",
]
