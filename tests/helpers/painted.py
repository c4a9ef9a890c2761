"""Where in the picture the wall lies that coverage counts as seen."""

import numpy as np

from ursnav_torch.camera import Camera
from ursnav_torch.exploration.coverage import Coverage


def upper_half(shape: tuple[int, ...]) -> np.ndarray:
    """A scene (H, W) that pictures of a shape show in their upper half alone."""
    return np.repeat(np.arange(shape[0]) < shape[0] // 2, shape[1]).reshape(shape[:2])


def painted_rows(coverage: Coverage, camera: Camera, T_kidney_camera: np.ndarray) -> np.ndarray:
    """(P,) rows, px, at which a camera (4, 4) sees the patches of wall that were seen."""
    seen = coverage.patches.center_mm[coverage.seen()]
    pixels, _ = camera.project((seen - T_kidney_camera[:3, 3]) @ T_kidney_camera[:3, :3])
    return pixels[:, 1]
