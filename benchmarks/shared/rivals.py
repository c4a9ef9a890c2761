"""The rivals, each as a function from a query and views to distances (V,), lower is nearer."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.matching.methods.opencv import contour, pair_distance

Floats = NDArray[np.float64]
Rival = Callable[[Floats, Sequence[Floats]], Floats]

#: Pictures that rivals working on images get: edges of 250 x 250 px drawn 3 px wide.
_SIDE, _WIDTH = 250, 1


def available() -> tuple[dict[str, Rival], dict[str, str]]:
    """Rivals that can run here, by name, and for the others the reason why not."""
    rivals: dict[str, Rival] = {
        "chamfer distance": chamfer,
        "Hu moments": hu_moments,
        "normalized cross-correlation": correlation,
        "ORB with ratio test": lambda q, v: _keypoints(cv2.ORB_create(), cv2.NORM_HAMMING, q, v),
    }
    missing = {}
    if hasattr(cv2, "SIFT_create"):
        rivals["SIFT with ratio test"] = lambda q, v: _keypoints(cv2.SIFT_create(), cv2.NORM_L2, q, v)
    if hasattr(cv2, "createShapeContextDistanceExtractor"):
        rivals["OpenCV shape context, iterations 3"] = lambda q, v: _extractor(_shape_context(3), q, v)
        rivals["OpenCV shape context, iterations 1"] = lambda q, v: _extractor(_shape_context(1), q, v)
        rivals["OpenCV Hausdorff"] = lambda q, v: _extractor(cv2.createHausdorffDistanceExtractor(), q, v)
    else:
        missing["OpenCV shape context and Hausdorff"] = (
            "needs opencv-contrib-python-headless in place of opencv-python-headless"
        )
    return rivals, missing


def _shape_context(iterations: int) -> cv2.Algorithm:
    return cv2.createShapeContextDistanceExtractor(iterations=iterations)


def _extractor(extractor: cv2.Algorithm, query: Floats, views: Sequence[Floats]) -> Floats:
    q = contour(query)
    return np.array([pair_distance(extractor, q, contour(v)) for v in views])


def chamfer(query: Floats, views: Sequence[Floats]) -> Floats:
    """Mean distance from a query point to the view's nearest edge, and back, by distance transforms."""
    q = _pixels(query)
    to_query = _distance_map(q)
    out = []
    for view in views:
        v = _pixels(view)
        out.append(_distance_map(v)[q[:, 1], q[:, 0]].mean() + to_query[v[:, 1], v[:, 0]].mean())
    return np.array(out)


def hu_moments(query: Floats, views: Sequence[Floats]) -> Floats:
    """Difference of the logarithms of Hu's seven moments of the drawn edges."""
    q = _log_hu(query)
    return np.array([np.abs(_log_hu(v) - q).sum() for v in views])


def correlation(query: Floats, views: Sequence[Floats]) -> Floats:
    """One minus the normalized correlation of the drawn, blurred edges."""
    q = _blurred(query)
    return np.array([1 - float((q * _blurred(v)).sum()) for v in views])


def _keypoints(detector: cv2.Feature2D, norm: int, query: Floats, views: Sequence[Floats]) -> Floats:
    """Minus the matches that pass Lowe's ratio test of 0.75."""
    matcher = cv2.BFMatcher(norm)
    _, q = detector.detectAndCompute(_drawn(query), None)
    out = np.zeros(len(views))
    for i, view in enumerate(views):
        _, v = detector.detectAndCompute(_drawn(view), None)
        if q is None or v is None or len(v) < 2:
            continue
        pairs = (p for p in matcher.knnMatch(q, v, k=2) if len(p) == 2)
        out[i] = -sum(a.distance < 0.75 * b.distance for a, b in pairs)
    return out


def _pixels(points: Floats) -> NDArray[np.int64]:
    return np.clip(np.round(points), 0, _SIDE - 1).astype(int)


def _drawn(points: Floats) -> NDArray[np.uint8]:
    image = np.zeros((_SIDE, _SIDE), np.uint8)
    for x, y in _pixels(points):
        cv2.circle(image, (int(x), int(y)), _WIDTH, 255, -1)
    return image


def _distance_map(pixels: NDArray[np.int64]) -> NDArray[np.float32]:
    empty = np.full((_SIDE, _SIDE), 255, np.uint8)
    empty[pixels[:, 1], pixels[:, 0]] = 0
    return cv2.distanceTransform(empty, cv2.DIST_L2, 3)


def _log_hu(points: Floats) -> Floats:
    hu = cv2.HuMoments(cv2.moments(_drawn(points), binaryImage=True)).ravel()
    return np.sign(hu) * np.log10(np.abs(hu) + 1e-30)


def _blurred(points: Floats) -> NDArray[np.float32]:
    image = cv2.GaussianBlur(_drawn(points).astype(np.float32), (0, 0), 5)
    image -= image.mean()
    return image / max(float(np.linalg.norm(image)), 1e-12)
