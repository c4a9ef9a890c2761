"""A drive through the small phantom with a 5-DoF sensor on the tip."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import apply, inverse, look_along, transform_from
from ursnav_torch.kidney import Kidney

OFFSET_MM = (0.0, 1.2, -4.0)


@dataclass(frozen=True, slots=True)
class Drive:
    """Camera poses (N, 4, 4), the sensor's readings (N, 3) with noise of 0.7 mm RMS, and the true transform."""

    T_kidney_camera: NDArray[np.float64]
    position_em: NDArray[np.float64]
    axis_em: NDArray[np.float64]
    T_kidney_em: NDArray[np.float64]

    def error_mm(self, points_em: NDArray[np.float64], mapped_mm: NDArray[np.float64]) -> float:
        """Root mean square distance of points mapped into the kidney from where they truly are."""
        return float(np.sqrt(np.mean(np.sum((mapped_mm - apply(self.T_kidney_em, points_em)) ** 2, axis=-1))))


def drive_through(kidney: Kidney, calyces: list[int], seed: int = 0) -> Drive:
    """In and out of some calyces along the centerline, jittering and looking ahead."""
    rng, tree = np.random.default_rng(seed), kidney.centerline
    points, directions = [], []
    for calyx in calyces:
        path = tree.path_to(calyx)
        inside = np.linalg.norm(tree.points_mm[path] - tree.points_mm[path[-1]], axis=1) > 3.0 * kidney.scale
        way, tangent = tree.points_mm[path][inside], tree.tangents(path)[inside]
        points += [way, way[::-1]]
        directions += [tangent, tangent[::-1]]
    way, axis = np.concatenate(points), np.concatenate(directions)
    jitter = gaussian_filter1d(rng.normal(size=(2, *way.shape)), 3.0, axis=1)
    T = look_along(way + 1.5 * jitter[0], axis + 0.4 * jitter[1], rng.uniform(-0.3, 0.3, len(way)))
    T_kidney_em = transform_from(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 100, 3))
    sensor = apply(inverse(T_kidney_em), apply(T, np.broadcast_to(OFFSET_MM, way.shape)))
    axis_em = T[:, :3, 2] @ T_kidney_em[:3, :3] + rng.normal(0, 0.007, way.shape)
    noisy = sensor + rng.normal(0, 0.7 / 3**0.5, way.shape)
    return Drive(T, noisy, axis_em / np.linalg.norm(axis_em, axis=1, keepdims=True), T_kidney_em)


@pytest.fixture(scope="session")
def drive(phantom: Kidney) -> Drive:
    return drive_through(phantom, list(range(len(phantom.calyces))))
