"""OpenCV's own shape-context extractor, pair by pair, as the thesis used it (thesis section 3.5)."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from ursnav_torch.errors import InputError, MissingExtraError


@dataclass(frozen=True, slots=True)
class OpenCV:
    """`cv2.ShapeContextDistanceExtractor` with its own settings, faults included.

    A pair on which OpenCV throws gets an infinite distance.

    Attributes:
        iterations: rounds of matching and warping; OpenCV's default is 3.
        angular_bins: sectors, OpenCV's default.
        radial_bins: rings, OpenCV's default.
    """

    iterations: int = 3
    angular_bins: int = 12
    radial_bins: int = 4

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise InputError(f"iterations must be at least 1, got {self.iterations}.")

    def distances(self, query: Tensor, points: Tensor, mask: Tensor) -> Tensor:
        """Distances (V,) of a query (Pq, 2) px to views (V, P, 2) px with mask (V, P)."""
        extractor = self.extractor()
        q = contour(query.numpy())
        out = torch.full((len(points),), torch.inf)
        if not len(query):
            return out
        for v in range(len(points)):
            view = points[v, mask[v]]
            if len(view):
                out[v] = pair_distance(extractor, q, contour(view.numpy()))
        return out

    def extractor(self) -> Any:
        """A configured `cv2.ShapeContextDistanceExtractor`.

        Raises:
            MissingExtraError: this OpenCV was built without its contrib modules.
        """
        if not hasattr(cv2, "createShapeContextDistanceExtractor"):
            raise MissingExtraError(
                f"matching=opencv needs OpenCV's contrib modules, which OpenCV {cv2.__version__} here lacks; "
                "install the extra: pip install 'ursnav-torch[opencv]'. Where it is and its modules are still "
                "missing, the plain OpenCV was installed over it: run `pip install --force-reinstall --no-deps "
                "opencv-contrib-python-headless`. Or choose matching=nearest."
            )
        return cv2.createShapeContextDistanceExtractor(
            nAngularBins=self.angular_bins, nRadialBins=self.radial_bins, iterations=self.iterations
        )


def contour(points: np.ndarray) -> np.ndarray:
    """Points (N, 2) in the shape (1, N, 2) float32 that OpenCV's extractors take."""
    return np.ascontiguousarray(points, np.float32).reshape(1, -1, 2)


def pair_distance(extractor: Any, a: np.ndarray, b: np.ndarray) -> float:
    """The extractor's distance of two contours; inf where it throws or gives no number."""
    try:
        distance = float(extractor.computeDistance(a, b))
    except cv2.error:
        return float("inf")
    return distance if np.isfinite(distance) else float("inf")
