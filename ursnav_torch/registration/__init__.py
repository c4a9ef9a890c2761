"""EM frame to kidney frame: from touched landmarks, from touched surface points, or from the sensor's own path; and
the verdict of the EM sensor on what image matching says (thesis chapters 4.4-4.5)."""

from ursnav_torch.registration.centerline import branch_directions, register_centerline
from ursnav_torch.registration.files import Landmarks, read_landmarks
from ursnav_torch.registration.landmarks import RegistrationWarning, register_landmarks
from ursnav_torch.registration.readings import readings_in_kidney, recorded_readings
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.rigid import fit_rigid
from ursnav_torch.registration.touch import picked_points, touched_points
from ursnav_torch.registration.touched_surface import register_surface
from ursnav_torch.registration.validation import (
    Comparison,
    Confusion,
    ErrorBudget,
    camera_errors,
    compare_poses,
    confusion,
    position_threshold,
)

__all__ = [
    "Comparison",
    "Confusion",
    "ErrorBudget",
    "Landmarks",
    "Registration",
    "RegistrationWarning",
    "branch_directions",
    "camera_errors",
    "compare_poses",
    "confusion",
    "fit_rigid",
    "picked_points",
    "position_threshold",
    "read_landmarks",
    "readings_in_kidney",
    "recorded_readings",
    "register_centerline",
    "register_landmarks",
    "register_surface",
    "touched_points",
]
