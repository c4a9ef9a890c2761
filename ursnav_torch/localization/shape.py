"""Shape distance of a picture to chosen views, each at a roll of its own."""

import math

from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import EdgePoints
from ursnav_torch.matching import Matcher, Matching
from ursnav_torch.vid import ViewFeatures

#: The query is turned in steps of this, radians; a shape context's sectors are 30 degrees wide.
ROLL_STEP = math.radians(7.5)


class ShapeStage:
    """The VID's edge points, prepared for shape matching.

    Args:
        features: of the VID's views.
        camera: the lens; rolls turn about its principal point.
        matching: how shapes are compared.
    """

    def __init__(self, features: ViewFeatures, camera: Camera, matching: Matching) -> None:
        self._center = (camera.cx, camera.cy)
        self._matcher = Matcher(
            features.points, features.mask, features.direction, matching, roll_center_px=self._center
        )

    def everywhere(self, edges: EdgePoints) -> Tensor:
        """Distance (V,) to every view, at the rolls that the matching settings name."""
        return self._matcher.distances(edges.points, edges.direction)

    def at_rolls(self, edges: EdgePoints, views: Tensor, rolls: Tensor) -> Tensor:
        """Distance (K,) to views (K,), the picture turned back by each view's roll (K,) in radians."""
        return self._matcher.distances_at_rolls(edges.points, views, rolls, ROLL_STEP, edges.direction)
