"""The devices: camera, EM tracker, robot, light and gamepad, each with one contract and several drivers."""

from ursnav_torch.devices.base import (
    SILENT_S,
    CameraDevice,
    CommandSample,
    Device,
    EmTracker,
    Frame,
    Gamepad,
    JointRates,
    Joints,
    Lamp,
    LightSample,
    Note,
    OperatorInput,
    Output,
    RobotSample,
    SourceAtEndError,
    Stamp,
    Stamper,
    TrackerSample,
)
from ursnav_torch.devices.cameras import FolderCamera, OpenCvCamera, VideoCamera
from ursnav_torch.devices.gamepads.gamepads import KeyboardGamepad, PygameGamepad, ScriptedGamepad
from ursnav_torch.devices.gamepads.mapping import GamepadMapping
from ursnav_torch.devices.igtl.server import OpenIgtlServer, SlicerOutput
from ursnav_torch.devices.robots.grbl import GrblRobot
from ursnav_torch.devices.robots.kinematics import Drive, Segment, tip_transform
from ursnav_torch.devices.robots.light import RobotLight
from ursnav_torch.devices.robots.robot import Robot
from ursnav_torch.devices.robots.rosserial import RosserialLight, RosserialRobot
from ursnav_torch.devices.robots.safety import Limits, SafetyGate, clamp_rates
from ursnav_torch.devices.ros import RosBridge, RosGamepad
from ursnav_torch.devices.trackers.csv_file import CsvTracker
from ursnav_torch.devices.trackers.ndi import NdiTracker
from ursnav_torch.devices.trackers.openigtlink import OpenIgtlTracker
from ursnav_torch.devices.trackers.surgery_ndi import SurgeryNdiTracker

__all__ = [
    "SILENT_S",
    "CameraDevice",
    "CommandSample",
    "CsvTracker",
    "Device",
    "Drive",
    "EmTracker",
    "FolderCamera",
    "Frame",
    "Gamepad",
    "GamepadMapping",
    "GrblRobot",
    "JointRates",
    "Joints",
    "KeyboardGamepad",
    "Lamp",
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
    "Robot",
    "RobotLight",
    "RobotSample",
    "RosBridge",
    "RosGamepad",
    "RosserialLight",
    "RosserialRobot",
    "SafetyGate",
    "ScriptedGamepad",
    "Segment",
    "SlicerOutput",
    "SourceAtEndError",
    "Stamp",
    "Stamper",
    "SurgeryNdiTracker",
    "TrackerSample",
    "VideoCamera",
    "clamp_rates",
    "tip_transform",
]
