"""Image-based navigation for robotic ureteroscopy: which calyx is this, and where is the tip?

Research software, not a medical device.
"""

import os
from importlib import import_module
from typing import Any

#: OpenCV reads this when it is imported: a picture of more pixels is refused before memory is taken for it.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "40000000")

_PUBLIC = {
    "Localizer": "localization",
    "Location": "localization",
    "LocalizationSettings": "localization",
    "UrsnavError": "errors",
    "equidistant_camera": "camera",
    "load_camera": "camera",
    "load_mesh_kidney": "kidney",
    "load_vid": "vid",
    "make_phantom_kidney": "kidney",
    "pinhole_camera": "camera",
    "read_image": "features",
    "register_landmarks": "registration",
    "shape_distances": "matching",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``import ursnav_torch`` stays quick."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'ursnav_torch' has no attribute {name!r}")
    return getattr(import_module(f"ursnav_torch.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return __all__
