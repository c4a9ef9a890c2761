"""The pictures' lens as a runner's ``camera=`` states it, or the calibration of the camera that takes them."""

from collections.abc import Callable, Mapping
from typing import Any

from ursnav_torch.camera import Camera, load_camera


def stated_lens(choice: Any, make: Callable[[Any], Camera]) -> tuple[Camera | None, bool]:
    """The lens of a choice, None where there is none; and whether it says that pictures were cropped or scaled."""
    if not choice:
        return None, False
    return make(choice), choice.get("crop") is not None or choice.get("resize") is not None


def lens_of(choice: Any, hardware: Mapping[str, Any], make: Callable[[Any], Camera]) -> tuple[Camera | None, bool]:
    """`stated_lens`; where nothing is stated, the lens of the calibration that a rig's camera is given.

    Args:
        choice: ``camera=``.
        hardware: ``hardware=``, a rig's or a record's.
        make: makes a lens of a choice.
    """
    calibration = (hardware.get("camera") or {}).get("calibration")
    if choice or not calibration:
        return stated_lens(choice, make)
    return load_camera(calibration), False
