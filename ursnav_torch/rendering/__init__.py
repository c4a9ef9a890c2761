"""Draws the lumen from inside: ``render(T_kidney_camera) -> View``, by ray casting or OpenGL; light; sensor faults."""

from ursnav_torch.rendering.base import Renderer, View
from ursnav_torch.rendering.deform import Deformation, WarpSettings, deform_mesh
from ursnav_torch.rendering.light import FlatLight, HeadLight, Light, percentile
from ursnav_torch.rendering.raycast import RaycastRenderer, RayScene

__all__ = [
    "Deformation",
    "FlatLight",
    "HeadLight",
    "Light",
    "RayScene",
    "RaycastRenderer",
    "Renderer",
    "View",
    "WarpSettings",
    "deform_mesh",
    "percentile",
]
