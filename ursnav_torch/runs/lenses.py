"""The pictures' lens as a runner's ``camera=`` states it."""

from collections.abc import Callable
from typing import Any

from ursnav_torch.camera import Camera


def stated_lens(choice: Any, make: Callable[[Any], Camera]) -> tuple[Camera | None, bool]:
    """The lens of a choice, None where there is none; and whether it says that pictures were cropped or scaled."""
    if not choice:
        return None, False
    return make(choice), choice.get("crop") is not None or choice.get("resize") is not None
