"""What people look at: reports, pictures of the kidney from outside. Nothing here decides anything."""

from ursnav_torch.viewer.demo import PresetScore, run_demo
from ursnav_torch.viewer.matched import match_images
from ursnav_torch.viewer.overview import Overview, draw_overview
from ursnav_torch.viewer.report import MatchReport, draw_edges

__all__ = ["MatchReport", "Overview", "PresetScore", "draw_edges", "draw_overview", "match_images", "run_demo"]
