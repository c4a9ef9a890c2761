"""The bending tip of a scope: a segment of constant curvature.

The bend is a vector: its length is the angle, its direction the axis in the x-y plane of the segment's base about
which the tip turns. Drivers move it, the simulation bends it, and tracking predicts by it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array


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
        s = self.length_mm if along_mm is None else along_mm
        x, y = (np.asarray(bend_rad, float) * (s / self.length_mm)).tolist()
        theta = math.hypot(x, y)
        cosine, sine = math.cos(theta), math.sin(theta)
        # sin a / a and (1 - cos a) / a^2, which a straight segment has, too
        one = sine / theta if theta > 1e-9 else 1.0
        half = 2 * (math.sin(theta / 2) / theta) ** 2 if theta > 1e-9 else 0.5
        return np.array([
            [cosine + half * x * x, half * x * y, one * y, s * half * y],
            [half * x * y, cosine + half * y * y, -one * x, -s * half * x],
            [-one * y, one * x, cosine, s * one],
            [0.0, 0.0, 0.0, 1.0],
        ])  # fmt: skip

    def pulls_mm(self, bend_rad: ArrayLike) -> Array:
        """How far (2,) the motors of the pairs x and y have pulled their + cables in at a bend (2,)."""
        return self.cable_radius_mm * np.asarray(bend_rad, float)

    def bend_from_pulls(self, pulls_mm: ArrayLike) -> Array:
        """The bend (2,) about x and y, radians, at pulls (2,) in mm; the inverse of `pulls_mm`."""
        return np.asarray(pulls_mm, float) / self.cable_radius_mm

    def bend_for_turn(self, bend_rad: ArrayLike, turn_rad: ArrayLike) -> Array:
        """The change of bend (2,) that turns the tip by a small turn (2,) about its own x and y axes.

        Args:
            bend_rad: (2,) present bend about x and y.
            turn_rad: (2,) turn about the tip's axes; where the segment cannot make one (it does not roll), the nearest.
        """
        bend, step = np.asarray(bend_rad, float), 1e-3
        R = self.point_transform(bend)[:3, :3]
        columns = []
        for axis in range(2):
            d = R.T @ self.point_transform(bend + step * np.eye(2)[axis])[:3, :3]
            columns.append(np.array([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0]]) / (2 * step))
        return np.asarray(np.linalg.lstsq(np.stack(columns, axis=1), np.asarray(turn_rad, float), rcond=1e-2)[0])


def turn_towards(direction: ArrayLike) -> Array:
    """The turn (2,) about the tip's x and y axes that brings its z axis to a direction (3,) in its frame, radians."""
    way = np.asarray(direction, float)
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    across = np.array([-way[1], way[0]])
    size = float(np.linalg.norm(across))
    if size < 1e-9:  # straight ahead, or straight behind: any axis will do
        return np.zeros(2) if way[2] > 0 else np.array([np.pi, 0.0])
    return across / size * float(np.arctan2(size, way[2]))
