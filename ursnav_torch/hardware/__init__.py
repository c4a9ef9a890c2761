"""The devices: camera, EM tracker, robot, light and gamepad, each with one contract, several drivers and a simulation.

`build_rig` puts devices together, `Control` drives a robot with a gamepad, `make_twin` makes the scope that the
simulated devices share. Devices know nothing of navigation. Not a medical device: for phantoms and research.
"""

from ursnav_torch.hardware.base import (
    Camera,
    CommandSample,
    Device,
    Frame,
    Gamepad,
    JointRates,
    Joints,
    Light,
    LightSample,
    Note,
    OperatorInput,
    Output,
    RobotSample,
    SourceAtEndError,
    Stamp,
    Stamper,
    Tracker,
    TrackerSample,
)
from ursnav_torch.hardware.cameras import FolderCamera, OpenCvCamera, VideoCamera
from ursnav_torch.hardware.csv_tracker import CsvTracker
from ursnav_torch.hardware.em_field import EmField
from ursnav_torch.hardware.gamepad_mapping import GamepadMapping
from ursnav_torch.hardware.gamepads import KeyboardGamepad, PygameGamepad, ScriptedGamepad
from ursnav_torch.hardware.grbl import GrblRobot
from ursnav_torch.hardware.igtl_server import OpenIgtlServer, SlicerOutput
from ursnav_torch.hardware.igtl_tracker import OpenIgtlTracker
from ursnav_torch.hardware.kinematics import Drive, Segment, tip_transform
from ursnav_torch.hardware.ndi import NdiTracker
from ursnav_torch.hardware.pilot import TwinPilot
from ursnav_torch.hardware.rig import LATER, Control, Rig, RobotLight, World, build_rig
from ursnav_torch.hardware.robot import Robot
from ursnav_torch.hardware.ros import RosBridge, RosGamepad
from ursnav_torch.hardware.rosserial_robot import RosserialLight, RosserialRobot
from ursnav_torch.hardware.safety import Limits, SafetyGate, clamp_rates
from ursnav_torch.hardware.simulated import (
    SimulatedGrblRobot,
    SimulatedNdiTracker,
    SimulatedOpenIgtlTracker,
    SimulatedRosserialRobot,
    TwinCamera,
    make_twin,
)
from ursnav_torch.hardware.surgery_ndi import SurgeryNdiTracker
from ursnav_torch.hardware.twin import Scope, Twin

__all__ = [
    "LATER",
    "Camera",
    "CommandSample",
    "Control",
    "CsvTracker",
    "Device",
    "Drive",
    "EmField",
    "FolderCamera",
    "Frame",
    "Gamepad",
    "GamepadMapping",
    "GrblRobot",
    "JointRates",
    "Joints",
    "KeyboardGamepad",
    "Light",
    "LightSample",
    "Limits",
    "NdiTracker",
    "Note",
    "OpenCvCamera",
    "OpenIgtlServer",
    "OpenIgtlTracker",
    "OperatorInput",
    "Output",
    "PygameGamepad",
    "Rig",
    "Robot",
    "RobotLight",
    "RobotSample",
    "RosBridge",
    "RosGamepad",
    "RosserialLight",
    "RosserialRobot",
    "SafetyGate",
    "Scope",
    "ScriptedGamepad",
    "Segment",
    "SimulatedGrblRobot",
    "SimulatedNdiTracker",
    "SimulatedOpenIgtlTracker",
    "SimulatedRosserialRobot",
    "SlicerOutput",
    "SourceAtEndError",
    "Stamp",
    "Stamper",
    "SurgeryNdiTracker",
    "Tracker",
    "TrackerSample",
    "Twin",
    "TwinCamera",
    "TwinPilot",
    "VideoCamera",
    "World",
    "build_rig",
    "clamp_rates",
    "make_twin",
    "tip_transform",
]
