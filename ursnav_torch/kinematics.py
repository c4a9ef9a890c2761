"""The bending tip of a scope: a segment of constant curvature.

The bend is a vector: its length is the angle, its direction the axis in the x-y plane of the segment's base about
which the tip turns. Drivers move it, the simulation bends it, and tracking predicts by it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, transform_from


@dataclass(frozen=True, slots=True)
class Segment:
    """A cable-driven segment of constant curvature; ``cable_radius_mm`` from its axis to the cables.

    Raises:
        InputError: a length is not positive.
    """

    length_mm: float = 20.0
    cable_radius_mm: float = 2.0
    max_bend_rad: float = math.radians(120.0)

    def __post_init__(self) -> None:
        for name in ("length_mm", "cable_radius_mm", "max_bend_rad"):
            if not getattr(self, name) > 0:
                raise InputError(f"Segment {name} must be positive, got {getattr(self, name)}.")

    def point_transform(self, bend_rad: ArrayLike, along_mm: float | None = None) -> Array:
        """Transform (4, 4) to the base from the point ``along_mm`` up the segment (its tip without it).

        Args:
            bend_rad: (2,) bend of the whole segment about x and y.
            along_mm: distance along the curve; may go beyond the tip or below 0 on the same circle.
        """
        bend = np.asarray(bend_rad, float)
        s = self.length_mm if along_mm is None else along_mm
        turn = bend * s / self.length_mm
        theta = float(np.hypot(*turn))
        R = Rotation.from_rotvec([*turn, 0.0]).as_matrix()
        sideways = s / 2 * np.sinc(theta / 2 / np.pi) ** 2 * np.array([turn[1], -turn[0]])
        return transform_from(R, [*sideways, s * np.sinc(theta / np.pi)])

    def pulls_mm(self, bend_rad: ArrayLike) -> Array:
        """How far (2,) the motors of the pairs x and y have pulled their + cables in at a bend (2,)."""
        return self.cable_radius_mm * np.asarray(bend_rad, float)

    def bend_from_pulls(self, pulls_mm: ArrayLike) -> Array:
        """The bend (2,) about x and y, radians, at pulls (2,) in mm; the inverse of `pulls_mm`."""
        return np.asarray(pulls_mm, float) / self.cable_radius_mm
