"""Shape contexts of a picture compared with those of chosen views, the picture turned for each as the scan found."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import EdgePoints
from ursnav_torch.matching import Assignment, Matcher, Matching
from ursnav_torch.vid import ViewFeatures


class ShapeStage:
    """The VID's edge points, prepared for shape matching.

    Args:
        features: of the VID's views.
        camera: the lens.
        matching: how shapes are compared.
    """

    def __init__(self, features: ViewFeatures, camera: Camera, matching: Matching) -> None:
        self._camera = camera
        self._matcher = Matcher(
            features.points, features.mask, features.direction, matching, roll_center_px=(camera.cx, camera.cy)
        )

    def everywhere(self, edges: EdgePoints) -> tuple[Tensor, Tensor]:
        """Distance (V,) to every view at the nearest of the rolls that the matching names, and that roll (V,) rad."""
        return self._matcher.nearest_rolls(edges.points, edges.direction)

    def finalists(self, edges: EdgePoints, views: Tensor, R_view_query: NDArray[np.float64]) -> Assignment:
        """Distances and correspondences with views (K,), the camera turned by ``R_view_query`` (K, 3, 3) against each.

        What a point of the picture counts would enter here, as weights (Pq,) of `Matcher.assign`.
        """
        points, direction = turn_edges(edges, self._camera, R_view_query)
        return self._matcher.assign(points, direction, views)


def turn_edges(edges: EdgePoints, camera: Camera, R: NDArray[np.float64]) -> tuple[Tensor, Tensor]:
    """Edge points as cameras see them that are turned by R (K, 3, 3): ``ray there = R @ ray here``.

    Returns:
        points (K, N, 2) px and directions (K, N) radians.
    """
    pixels = edges.points.numpy().astype(float)
    along = np.stack([np.cos(edges.direction.numpy()), np.sin(edges.direction.numpy())], axis=1)
    rays = camera.rays(np.stack([pixels, pixels + 0.5 * along]))[0]  # (2, N, 3): here and ahead
    turned = (rays[:, None] @ np.swapaxes(R, 1, 2)).astype(np.float32)  # (2, K, N, 3)
    x, y = camera.pixels(np.ascontiguousarray(np.moveaxis(turned, -1, 0)))
    direction = np.remainder(np.arctan2(y[1] - y[0], x[1] - x[0]), np.float32(np.pi))
    return torch.from_numpy(np.stack([x[0], y[0]], -1)), torch.from_numpy(direction)
