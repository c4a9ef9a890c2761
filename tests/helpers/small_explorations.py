"""A kidney small enough to be explored whole in a test: three calyces of the phantom, in simulated time."""

from functools import partial

from ursnav_torch.autonomy import AutonomySettings
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney.build import build_kidney
from ursnav_torch.navigation import Navigator, run_navigation
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.session import rehearse
from ursnav_torch.simulation import World, make_twin
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import PlanSettings, build_vid

CALYCES = 3


def small_vid(phantom, lens, out):
    """A VID of the phantom's first calyces; nobody looks into the others."""
    kidney = build_kidney(phantom.mesh, "three calyces", 1.0, phantom.calyces[:CALYCES], phantom.pelvis_mm, None)
    plan = PlanSettings(views_per_calyx=24, passage_views=24)
    return build_vid(kidney, lens, DefaultSettings(), RaycastRenderer, plan, out, workers=1)


def explore_whole(vid, recorder=None, page=None):
    """Explore a VID's kidney in simulated time, with the tracker's own places; the summary."""

    def world():
        return World(vid.kidney, RaycastRenderer(vid.kidney.mesh, vid.camera), vid.lumen)

    hardware = partial(rehearse, make_twin, rate_hz=6.0)
    settings = AutonomySettings()
    return run_navigation(Navigator(Tracker(vid)), hardware, world, recorder, 120.0, page, settings)
