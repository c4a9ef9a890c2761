"""The digital twin, simulated boards on pseudo-terminals, the EM field and a pilot: a lab without a lab."""

from ursnav_torch.simulation.em_field import EmField
from ursnav_torch.simulation.pilot import TwinPilot
from ursnav_torch.simulation.simulated import (
    SimulatedGrblRobot,
    SimulatedNdiTracker,
    SimulatedOpenIgtlTracker,
    SimulatedRosserialRobot,
    TwinCamera,
    make_twin,
)
from ursnav_torch.simulation.stepped import SimulatedTime, SteppedCamera, SteppedRobot
from ursnav_torch.simulation.tissue import CALM, Tissue, TissueSettings, draw_tissue
from ursnav_torch.simulation.twin import Scope, Twin
from ursnav_torch.simulation.world import World

__all__ = [
    "CALM",
    "EmField",
    "Scope",
    "SimulatedGrblRobot",
    "SimulatedNdiTracker",
    "SimulatedOpenIgtlTracker",
    "SimulatedRosserialRobot",
    "SimulatedTime",
    "SteppedCamera",
    "SteppedRobot",
    "Tissue",
    "TissueSettings",
    "Twin",
    "TwinCamera",
    "TwinPilot",
    "World",
    "draw_tissue",
    "make_twin",
]
