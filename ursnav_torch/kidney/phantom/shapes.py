"""The parts that a phantom is made of, in anatomical mm. Frame: x lateral, y anterior, z superior, pelvis at 0."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """How an outline departs from a circle: by its second and third harmonic.

    Attributes:
        lobes: (2,) amplitudes relative to the radius.
        phases: (2,) angles in radians.
    """

    lobes: Array
    phases: Array

    def at(self, angle: Array) -> Array:
        """Radius relative to the mean at angles (...) in radians."""
        return 1 + sum(a * np.cos(k * angle - p) for k, a, p in zip((2, 3), self.lobes, self.phases, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """A bent tube.

    Attributes:
        points_mm: (K, 3) its middle line, densely sampled.
        radius_mm: (K,) mean radius along it.
        outline: of its cross-section.
        twist: radians by which the outline turns from one end to the other.
        flat_end: whether it ends in a plane across (the cut ureter) and not in a dome.
    """

    points_mm: Array
    radius_mm: Array
    outline: Outline
    twist: float
    flat_end: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Papilla:
    """A rounded cone pushed into a cup.

    Attributes:
        at_mm: (2,) its place across the cup, along the long and the short side.
        foot_mm: radius at the bottom of the cup.
        height_mm: how far it reaches in.
        tilt: (2,) slope of its foot, so that the fornix is deeper on one side.
    """

    at_mm: Array
    foot_mm: float
    height_mm: float
    tilt: Array


@dataclass(frozen=True, slots=True, eq=False)
class Cup:
    """The end of a minor calyx: a widening cup with one papilla or two.

    Attributes:
        base_mm: (3,) middle of its mouth.
        axes: (3, 3) rows: long side, short side, and the axis from the mouth to the papilla.
        radii_mm: (2,) half widths along the two sides.
        outline: of its cross-section, on top of the two half widths.
        neck_mm: radius at the mouth.
        depth_mm: from the mouth to the fornix.
        papillae: one, or two in a compound calyx.
    """

    base_mm: Array
    axes: Array
    radii_mm: Array
    outline: Outline
    neck_mm: float
    depth_mm: float
    papillae: tuple[Papilla, ...]

    @property
    def end_mm(self) -> Array:
        """(3,) middle of the bottom."""
        return self.base_mm + self.axes[2] * self.depth_mm

    def local(self, points_mm: Array) -> Array:
        """Points (..., 3) along the long side, the short side and the axis, from the base."""
        return (points_mm - self.base_mm) @ self.axes.T


@dataclass(frozen=True, slots=True, eq=False)
class PhantomPlan:
    """A whole collecting system.

    Attributes:
        pelvis_mm: (3,) half axes of the pelvis along x, y, z.
        ureter: from the pelvis, cut across.
        majors: the infundibula of the major calyces.
        minors: the infundibula of the minor calyces, one a cup.
        cups: in the order of ``minors``.
    """

    pelvis_mm: Array
    ureter: Tube
    majors: tuple[Tube, ...]
    minors: tuple[Tube, ...]
    cups: tuple[Cup, ...]

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """All tubes."""
        return (self.ureter, *self.majors, *self.minors)

    def gap_mm(self) -> float:
        """The smallest gap between a cup and another cup, a foreign tube, or the pelvis; negative if they meet."""
        middle = np.array([c.base_mm + 0.6 * c.depth_mm * c.axes[2] for c in self.cups])
        radius = np.array([c.radii_mm.max() for c in self.cups])
        between = np.linalg.norm(middle[:, None] - middle, axis=-1) - radius[:, None] - radius
        gaps = [between[~np.eye(len(middle), dtype=bool)].min()]
        gaps.append(((np.linalg.norm(middle / self.pelvis_mm, axis=1) - 1) * self.pelvis_mm.min() - radius).min())
        for i, tube in enumerate((*self.minors, *self.majors, self.ureter)):
            others = np.arange(len(middle)) != i
            away = np.linalg.norm(middle[others, None] - tube.points_mm[::3], axis=-1) - tube.radius_mm[::3]
            gaps.append((away.min(axis=1) - radius[others]).min())
        return float(min(gaps))
