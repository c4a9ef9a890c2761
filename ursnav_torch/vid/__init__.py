"""The virtual image database: views of a kidney with known poses, planned, drawn, stored, loaded."""

from ursnav_torch.vid.base import Vid, ViewFeatures
from ursnav_torch.vid.build import build_vid
from ursnav_torch.vid.compute import Compute, DaskCompute, LocalCompute
from ursnav_torch.vid.draw import MakeRenderer, Studio, pack
from ursnav_torch.vid.exchange import CollectedViews, export_thesis, read_poses, read_views
from ursnav_torch.vid.plan import Plan, PlanSettings, plan_views
from ursnav_torch.vid.screen import SCREEN_FROM, Screen, make_screen
from ursnav_torch.vid.store import load_vid, pose_cells, poses_from_rows, save_vid

__all__ = [
    "SCREEN_FROM",
    "CollectedViews",
    "Compute",
    "DaskCompute",
    "LocalCompute",
    "MakeRenderer",
    "Plan",
    "PlanSettings",
    "Screen",
    "Studio",
    "Vid",
    "ViewFeatures",
    "build_vid",
    "export_thesis",
    "load_vid",
    "make_screen",
    "pack",
    "plan_views",
    "pose_cells",
    "poses_from_rows",
    "read_poses",
    "read_views",
    "save_vid",
]
