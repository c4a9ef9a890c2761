"""The bending segment and its cables: bend <-> cable pulls <-> motor steps, and joints -> tip pose.

A segment of constant curvature (thesis §4.3.1: 20 mm long, up to 120 degrees). The bend is a vector: its
length is the angle, its direction the axis in the x-y plane of the segment's base about which the tip turns.
Two pairs of cables run at right angles; the pair *x* turns the tip about x, the pair *y* about y:
pulling (shortening) the cable at -y turns it about +x, the one at +x about +y.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ursnav_torch.devices.base import Joints
from ursnav_torch.geometry import Array
from ursnav_torch.kinematics import Segment


@dataclass(frozen=True, slots=True)
class Drive:
    """The drive train: what the controller's three axes (cable x, cable y, slider) do to the joints.

    ``steps_per_mm`` gives motor steps for a mm of cable, cable, slider. With the thesis's motors, 200 steps
    times 16 microsteps times a gear of 5.18 on a 10 mm drum (31.4 mm a turn) are 528 a mm.
    """

    segment: Segment = field(default_factory=Segment)
    steps_per_mm: tuple[float, float, float] = (528.0, 528.0, 400.0)

    def axes_mm(self, joints: Joints) -> Array:
        """Axis positions (3,) in mm: cable pulls x and y, slider."""
        pulls = self.segment.pulls_mm([joints.bend_x_rad, joints.bend_y_rad])
        return np.array([*pulls, joints.insertion_mm])

    def joints(self, axes_mm: ArrayLike) -> Joints:
        """Joints of axis positions (3,) in mm; the inverse of `axes_mm`."""
        axes = np.asarray(axes_mm, float)
        bend = self.segment.bend_from_pulls(axes[:2])
        return Joints(float(bend[0]), float(bend[1]), float(axes[2]))

    def steps(self, joints: Joints) -> tuple[int, int, int]:
        """Motor steps from the straight, withdrawn position, rounded to whole steps."""
        x, y, z = np.rint(self.axes_mm(joints) * self.steps_per_mm).astype(int).tolist()
        return x, y, z

    def joints_from_steps(self, steps: ArrayLike) -> Joints:
        """Joints of motor steps (3,): cable x, cable y, slider; the inverse of `steps` to half a step."""
        return self.joints(np.asarray(steps, float) / self.steps_per_mm)


def tip_transform(segment: Segment, joints: Joints) -> Array:
    """Tip pose (4, 4) in the slider's frame: forward along z by the insertion, then the bend."""
    T = segment.point_transform([joints.bend_x_rad, joints.bend_y_rad])
    T[2, 3] += joints.insertion_mm
    return T
