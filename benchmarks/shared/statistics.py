"""Small statistics that several suites print."""

import numpy as np
from numpy.typing import NDArray


def wilson(right: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's interval (low, high) in 0..1 of a share (Wilson 1927)."""
    if count == 0:
        return 0.0, 1.0
    share, square = right / count, z * z / count
    middle = share + square / 2
    half = z * np.sqrt(share * (1 - share) / count + square / (4 * count))
    return float((middle - half) / (1 + square)), float((middle + half) / (1 + square))


def calibration_error(confidence: NDArray[np.float64], right: NDArray[np.bool_], bins: int = 10) -> float:
    """Expected calibration error: mean gap between confidence and share right over equal bins, weighted by count."""
    index = np.minimum((confidence * bins).astype(int), bins - 1)
    gaps = [abs(confidence[index == b].mean() - right[index == b].mean()) * (index == b).sum() for b in set(index)]
    return float(np.sum(gaps) / len(confidence))


def auroc(confidence: NDArray[np.float64], right: NDArray[np.bool_]) -> float:
    """Chance that a right answer has more confidence than a wrong one; nan when all are right or all wrong."""
    good, bad = confidence[right], confidence[~right]
    if not len(good) or not len(bad):
        return float("nan")
    wins = (good[:, None] > bad[None]).mean() + 0.5 * (good[:, None] == bad[None]).mean()
    return float(wins)
