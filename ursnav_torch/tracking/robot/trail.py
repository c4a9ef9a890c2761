"""Where the shaft lies: what the tip passed on its way in tells where it is on its way out.

A shaft that is pulled goes the way that its tip came (follow the leader), and the segment before it turns as the cables
ask, unless a wall holds the tip. Once that lets go, the tip springs aside by millimeters within one picture: no motor
tells of it, and alignment does not reach as far. Poses told from the trail only begin alignments; pictures decide.

The simulated scope is pulled and held by the same rules, so that flights in it flatter this; a real one's shaft has
room in the pelvis, which no record at hand measures.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.tracking.robot.odometry import Odometry

Array = NDArray[np.float64]
#: Marks lie so far apart along the shaft, and a tip's middle keeps so far off walls (half of a thin scope's diameter,
#: less what tissue gives way), mm at the kidney's scale 1.
_APART_MM, _KEEPS_OFF_MM = 0.3, 0.6
#: How finely it is looked for a wall in the tip's way.
_SHARES = np.linspace(0.0, 1.0, 33)


@dataclass(frozen=True, slots=True)
class _Mark:
    """A place on the way in: how deep the shaft was, its bend (2,) and the tip's pose (4, 4)."""

    inserted_mm: float
    bend: Array
    T_kidney_camera: Array


class ShaftTrail:
    """Poses of the tip by how deep the shaft was, as far in as it is now.

    Args:
        odometry: hears the robot.
        lumen: distances to the wall.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    def __init__(self, odometry: Odometry, lumen: LumenDistance, unit_mm: float = 1.0) -> None:
        self._odometry, self._lumen = odometry, lumen
        self._apart, self._keeps_off = _APART_MM * unit_mm, _KEEPS_OFF_MM * unit_mm
        self.reset()

    def reset(self) -> None:
        """Forget the way in."""
        self._marks: list[_Mark] = []

    def mark(self, T_kidney_camera: Array) -> None:
        """Remember a sure pose (4, 4) if the shaft is being pushed; what lay deeper is no way in any more."""
        odometry, marks = self._odometry, self._marks
        if not odometry.pushed:
            return
        while marks and marks[-1].inserted_mm > odometry.inserted_mm:
            marks.pop()
        if not marks or odometry.inserted_mm - marks[-1].inserted_mm >= self._apart:
            marks.append(_Mark(odometry.inserted_mm, odometry.bend, T_kidney_camera))

    def expected(self) -> list[Array]:
        """Where (4, 4) the tip may be: held by a wall, and free of it; nothing unless the shaft has been pulled."""
        odometry, marks = self._odometry, self._marks
        depth = odometry.inserted_mm + odometry.insertion.width()  # the shaft lags behind the slider
        if not marks or marks[-1].inserted_mm <= depth:
            return []
        mark = next((m for m in reversed(marks) if m.inserted_mm <= depth), marks[0])
        base, tip = (odometry.segment.point_transform(bend) for bend in (mark.bend, odometry.bend))
        about = transform_from(Rotation.from_rotvec([0, 0, odometry.roll()]).as_matrix(), np.zeros(3))
        free = mark.T_kidney_camera @ about @ inverse(base) @ tip @ inverse(about)
        start = mark.T_kidney_camera[:3, 3]
        places = start + _SHARES[:, None] * (free[:3, 3] - start)
        clear = self._lumen.clearance_mm(places) >= self._keeps_off
        if clear.all():
            return [free]
        held = free.copy()
        held[:3, 3] = places[max(int(clear.argmin()) - 1, 0)]
        return [held, free]
