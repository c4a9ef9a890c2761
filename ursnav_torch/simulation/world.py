"""What a simulated scope lives in."""

from dataclasses import dataclass

from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import Renderer


@dataclass(frozen=True, slots=True)
class World:
    """What a twin lives in.

    Attributes:
        kidney: the anatomy.
        renderer: draws it through the scope's lens.
        lumen: its distances where they are known already, as a VID knows them; None finds them when a twin is made.
    """

    kidney: Kidney
    renderer: Renderer
    lumen: LumenDistance | None = None
