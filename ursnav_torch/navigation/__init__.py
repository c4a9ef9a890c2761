"""Live navigation: a `Navigator` turns the pictures of a session into states on a bus, `run_navigation` runs it.

Observers, the page among them, look at the newest state whenever they like; nobody who looks slows the loop.
"""

from ursnav_torch.navigation.bus import Newest, StateBus
from ursnav_torch.navigation.effort import WORDS, Governor
from ursnav_torch.navigation.em import sensor_in_kidney
from ursnav_torch.navigation.guide import Guide
from ursnav_torch.navigation.navigator import Navigator
from ursnav_torch.navigation.run import NavigationSummary, Page, run_navigation
from ursnav_torch.navigation.state import Guidance, Latency, NavigationState
from ursnav_torch.navigation.status import confidence_words, status_line, turn_words, way_ahead
from ursnav_torch.navigation.trail import Trail

__all__ = [
    "WORDS",
    "Governor",
    "Guidance",
    "Guide",
    "Latency",
    "NavigationState",
    "NavigationSummary",
    "Navigator",
    "Newest",
    "Page",
    "StateBus",
    "Trail",
    "confidence_words",
    "run_navigation",
    "sensor_in_kidney",
    "status_line",
    "turn_words",
    "way_ahead",
]
