"""EM frame to kidney frame: from touched landmarks, from touched surface points, or from the sensor's own path; and
the verdict of the EM sensor on what image matching says (thesis chapters 4.4-4.5)."""

from ursnav_torch.registration.files import EmSamples, Landmarks, join_names, read_em_samples, read_landmarks
from ursnav_torch.registration.landmarks import RegistrationWarning, register_landmarks
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.rigid import fit_rigid
from ursnav_torch.registration.touch import picked_points, touched_points

__all__ = [
    "EmSamples",
    "Landmarks",
    "Registration",
    "RegistrationWarning",
    "fit_rigid",
    "join_names",
    "picked_points",
    "read_em_samples",
    "read_landmarks",
    "register_landmarks",
    "touched_points",
]
