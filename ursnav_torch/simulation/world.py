"""What a simulated scope lives in."""

from dataclasses import dataclass

from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import Renderer


@dataclass(frozen=True, slots=True)
class World:
    """What a twin lives in: the anatomy and what draws it through the scope's lens."""

    kidney: Kidney
    renderer: Renderer
