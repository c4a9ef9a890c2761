"""Lens models and lenses from files: ours, ROS, Kalibr, OpenCV, COLMAP, OCamCalib; pixels <-> rays."""

from ursnav_torch.camera.cut import PictureCut, cut_of, scaled_to
from ursnav_torch.camera.lens import Camera, equidistant_camera, mask_text, pinhole_camera
from ursnav_torch.camera.models import MODELS
from ursnav_torch.camera.read import camera_from_dict, load_camera

__all__ = [
    "MODELS",
    "Camera",
    "PictureCut",
    "camera_from_dict",
    "cut_of",
    "equidistant_camera",
    "load_camera",
    "mask_text",
    "pinhole_camera",
    "scaled_to",
]
