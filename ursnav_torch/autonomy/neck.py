"""Necks: where the way to a calyx is too narrow for the scope; it looks in from before and does not force its way."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.steering import Way
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.geometry import look_along

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
    place = way.point_at(end)
    ahead = way.point_at(end + _AHEAD_MM * scale)
    return Neck(
        end,
        float(way.radius_mm[narrow].min()),
        limits.radius_mm,
        way.length_mm - begins,
        look_along(place, ahead - place),
    )
