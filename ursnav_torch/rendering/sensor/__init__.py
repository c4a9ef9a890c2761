"""What spoils a scope's picture: simulated light, wall, water, lens and sensor faults between a view and a picture."""

from ursnav_torch.rendering.sensor.bodies import STONE, Stone
from ursnav_torch.rendering.sensor.electronics import ElectronicsFaults
from ursnav_torch.rendering.sensor.light import LightFaults
from ursnav_torch.rendering.sensor.no_calyx import NO_CALYX_KINDS, none_pictures, pressed_pose
from ursnav_torch.rendering.sensor.occluders import OccluderFaults
from ursnav_torch.rendering.sensor.optics import OpticsFaults
from ursnav_torch.rendering.sensor.presets import (
    IN_VIVO_LIKE,
    PRESETS,
    WIDE,
    Preset,
    draw_faults,
    in_vivo_like,
    severity,
    thesis_phantom,
    thesis_simulation,
)  # fmt: skip
from ursnav_torch.rendering.sensor.simulate import SensorFaults, simulate, simulate_labeled, simulate_view
from ursnav_torch.rendering.sensor.wall import WallFaults

__all__ = [
    "IN_VIVO_LIKE",
    "NO_CALYX_KINDS",
    "PRESETS",
    "STONE",
    "WIDE",
    "ElectronicsFaults",
    "LightFaults",
    "OccluderFaults",
    "OpticsFaults",
    "Preset",
    "SensorFaults",
    "Stone",
    "WallFaults",
    "draw_faults",
    "in_vivo_like",
    "none_pictures",
    "pressed_pose",
    "severity",
    "simulate",
    "simulate_labeled",
    "simulate_view",
    "thesis_phantom",
    "thesis_simulation",
]
