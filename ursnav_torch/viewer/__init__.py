"""What people look at: reports, pictures of the kidney from outside. Nothing here decides anything."""

from ursnav_torch.viewer.ambiguity import draw_look_alikes, report_look_alikes
from ursnav_torch.viewer.demo import PresetScore, run_demo
from ursnav_torch.viewer.matched import check_results, match_images
from ursnav_torch.viewer.overview import Overview, draw_overview
from ursnav_torch.viewer.report import MatchReport, draw_edges

__all__ = [
    "MatchReport",
    "Overview",
    "PresetScore",
    "check_results",
    "draw_edges",
    "draw_look_alikes",
    "draw_overview",
    "match_images",
    "report_look_alikes",
    "run_demo",
]
