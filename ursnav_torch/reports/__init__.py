"""What people read afterwards: HTML pages and pictures of the kidney from outside. Nothing here decides anything."""

from ursnav_torch.reports.look_alikes import draw_look_alikes, report_look_alikes
from ursnav_torch.reports.matches import MatchReport, draw_edges
from ursnav_torch.reports.overview import Overview, draw_overview

__all__ = ["MatchReport", "Overview", "draw_edges", "draw_look_alikes", "draw_overview", "report_look_alikes"]
