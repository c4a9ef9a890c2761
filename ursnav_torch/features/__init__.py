"""From a picture to what can be matched: edge points, and polar maps of relief and edge direction."""

from ursnav_torch.features.base import NO_EDGES, NO_MAPS, NOTHING_BEFORE, EdgePoints, Extractor, Features
from ursnav_torch.features.default import DefaultExtractor, DefaultSettings
from ursnav_torch.features.flatten import LocalPlane
from ursnav_torch.features.image import IMAGE_SUFFIXES, check_image, image_from_bytes, read_image
from ursnav_torch.features.polar import PolarGrid, polar_grid, polar_maps, polar_valid
from ursnav_torch.features.registry import (
    Settings,
    make_extractor,
    relief_extractor,
    settings_from_dict,
    settings_to_dict,
)
from ursnav_torch.features.rims import RimExtractor, RimSettings
from ursnav_torch.features.static import StillPixels, scene_of
from ursnav_torch.features.thesis import ThesisExtractor, ThesisSettings

__all__ = [
    "IMAGE_SUFFIXES",
    "NOTHING_BEFORE",
    "NO_EDGES",
    "NO_MAPS",
    "DefaultExtractor",
    "DefaultSettings",
    "EdgePoints",
    "Extractor",
    "Features",
    "LocalPlane",
    "PolarGrid",
    "RimExtractor",
    "RimSettings",
    "Settings",
    "StillPixels",
    "ThesisExtractor",
    "ThesisSettings",
    "check_image",
    "image_from_bytes",
    "make_extractor",
    "polar_grid",
    "polar_maps",
    "polar_valid",
    "read_image",
    "relief_extractor",
    "scene_of",
    "settings_from_dict",
    "settings_to_dict",
]
