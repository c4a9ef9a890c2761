"""What bars the way to a calyx: a neck too narrow for the scope, or a stone that leaves too little room beside it.

The scope looks in from before it and does not force its way.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.steering import Way
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.geometry import look_along
from ursnav_torch.stones import THERE, FoundStone

Array = NDArray[np.float64]

#: A way in ends so far before a neck, and from there it looks for what lies so far ahead; mm at scale 1.
_BEFORE_MM, _AHEAD_MM = 1.0, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Neck:
    """A stretch of a way whose lumen is narrower than the scope.

    Attributes:
        end_mm: how far along the way the scope may go.
        radius_mm: smallest radius of the lumen there.
        needed_mm: the radius that the scope needs.
        to_tip_mm: from where it begins to the calyx's tip.
        T_kidney_camera: (4, 4) the view along the way from its end.
    """

    end_mm: float
    radius_mm: float
    needed_mm: float
    to_tip_mm: float
    T_kidney_camera: Array

    def reason(self, calyx: str) -> str:
        """Why a calyx is not reached, for people to read."""
        return (
            f"the way narrows to a radius of {self.radius_mm:.1f} mm from {self.to_tip_mm:.0f} mm before the tip of "
            f"calyx {calyx}, and the scope needs {self.needed_mm:.1f} mm"
        )


@dataclass(frozen=True, slots=True, eq=False)
class StoneInTheWay:
    """A stone that the scope does not get past.

    Attributes:
        end_mm: how far along the way the scope may go.
        size_mm: of the stone.
        to_tip_mm: from where it begins to the calyx's tip.
        T_kidney_camera: (4, 4) the view along the way from its end.
    """

    end_mm: float
    size_mm: float
    to_tip_mm: float
    T_kidney_camera: Array

    def reason(self, calyx: str) -> str:
        """Why a calyx is not reached, for people to read."""
        return f"a stone of {self.size_mm:.0f} mm bars the way {self.to_tip_mm:.0f} mm before the tip of calyx {calyx}"


#: What the scope does not get past.
Bar = Neck | StoneInTheWay


def find_neck(way: Way, limits: ScopeLimits, scale: float) -> Neck | None:
    """The first neck of a way; None where there is none.

    Args:
        way: to a calyx.
        limits: of the scope, in mm of this kidney; a neck is none so near to the tip as a way may end.
        scale: the kidney's.
    """
    narrow = (way.radius_mm < limits.radius_mm) & (way.along_mm <= way.length_mm - limits.short_mm)
    if not narrow.any():
        return None
    begins = float(way.along_mm[int(narrow.argmax())])
    end = max(begins - _BEFORE_MM * scale, 0.0)
    radius = float(way.radius_mm[narrow].min())
    return Neck(end, radius, limits.radius_mm, way.length_mm - begins, _view(way, end, scale))


def find_stone(way: Way, stones: Iterable[FoundStone], limits: ScopeLimits, scale: float) -> StoneInTheWay | None:
    """The first of some stones that bars a way; None where none does.

    A stone does where the scope would have too little room beside it, even if it is smaller than told by one standard
    deviation. Arguments as of `find_neck`.
    """
    found: list[StoneInTheWay] = []
    for stone in (stone for stone in stones if stone.state == THERE):
        at = way.place_mm(stone.center_mm)
        aside = float(np.linalg.norm(way.point_at(at) - stone.center_mm))
        least, most = ((stone.size_mm + sign * stone.size_sd_mm) / 2 for sign in (-1, 1))
        room = (way.radius_at(at) + aside - least) / 2
        begins = at - most
        if room < limits.radius_mm and begins <= way.length_mm - limits.short_mm:
            end = max(begins - _BEFORE_MM * scale, 0.0)
            found.append(StoneInTheWay(end, stone.size_mm, way.length_mm - begins, _view(way, end, scale)))
    return min(found, key=lambda stone: stone.end_mm, default=None)


def _view(way: Way, at_mm: float, scale: float) -> Array:
    """(4, 4) the view along a way from so far along it."""
    place = way.point_at(at_mm)
    return look_along(place, way.point_at(at_mm + _AHEAD_MM * scale) - place)
