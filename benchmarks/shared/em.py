"""Simulated work for the EM sensor: drives through a kidney, and matches that are right or wrong in known ways."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import apply, inverse, look_along, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.vid import Plan

#: Sensor in the camera frame, its noise in mm RMS and that of its axis in rad, as the test data have them.
OFFSET_MM, EM_MM, AXIS_RAD = (0.0, 1.2, -4.0), 0.7, 0.01

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Drive:
    """Where the scope was, and what the sensor on its tip said.

    Attributes:
        T_kidney_camera: (N, 4, 4).
        position_em, axis_em: (N, 3) readings with noise.
        T_kidney_em: (4, 4) the transform that a registration should find.
    """

    T_kidney_camera: Array
    position_em: Array
    axis_em: Array
    T_kidney_em: Array

    def error_mm(self, points_em: Array, mapped_mm: Array) -> float:
        """Root mean square distance of points (N, 3) mapped into the kidney from where they truly are."""
        return rms(mapped_mm - apply(self.T_kidney_em, points_em))


def rms(difference: Array) -> float:
    """Root mean square length of vectors (N, 3)."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


def drive_through(kidney: Kidney, calyces: Sequence[int], seed: int = 0) -> Drive:
    """In and out of some calyces along the centerline to 3 mm before the tips, jittering and looking ahead."""
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
    return Drive(T, *readings(T, T_kidney_em, rng), T_kidney_em)


def readings(T_kidney_camera: Array, T_kidney_em: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Positions and axes (N, 3) that the sensor reads at camera poses (N, 4, 4)."""
    T_em_kidney, shape = inverse(T_kidney_em), (len(T_kidney_camera), 3)
    sensor = apply(T_em_kidney, apply(T_kidney_camera, np.broadcast_to(OFFSET_MM, shape)))
    axis = T_kidney_camera[:, :3, 2] @ T_em_kidney[:3, :3].T + rng.normal(0, AXIS_RAD / 2**0.5, shape)
    return sensor + rng.normal(0, EM_MM / 3**0.5, shape), axis / np.linalg.norm(axis, axis=1, keepdims=True)


def simulated_matches(kidney: Kidney, plan: Plan, count: int, seed: int = 0) -> tuple[Array, Array, NDArray[np.bool_]]:
    """True poses (N, 4, 4), matched poses (N, 4, 4), and whether the match is right (N,).

    Half of the matches are right, and off by 0.75 mm and 7.5 degrees RMS, with tails (Student's t with 5 degrees of
    freedom). The others are wrong, a third each: at the same
    place, but looking at the tip of another calyx; a view of another calyx from nearby (one of the five nearest); any
    view of another calyx.
    """
    rng = np.random.default_rng(seed)
    T, calyx = plan.T_kidney_camera[plan.calyx >= 0], plan.calyx[plan.calyx >= 0]
    true = rng.integers(len(T), size=count)
    kind = rng.choice(["right", "same", "near", "any"], size=count, p=[0.5, 1 / 6, 1 / 6, 1 / 6])
    off = rng.standard_t(5, size=(2, count, 3)) / np.sqrt(5 / 3) * [[[0.75 / 3**0.5]], [[np.radians(7.5) / 2**0.5]]]
    axis = T[true, :3, 2]
    for i in np.flatnonzero(kind == "same"):
        other = rng.choice(np.delete(np.arange(len(kidney.calyces)), calyx[true[i]]))
        way = kidney.tips_mm[other] - T[true[i], :3, 3]
        axis[i] = way / np.linalg.norm(way)
    matched = look_along(T[true, :3, 3] + off[0], axis + off[1])
    for i in np.flatnonzero((kind == "near") | (kind == "any")):
        others = np.flatnonzero(calyx != calyx[true[i]])
        if kind[i] == "near":
            distance = np.linalg.norm(T[others, :3, 3] - T[true[i], :3, 3], axis=1)
            others = others[distance.argsort()[:5]]
        matched[i] = T[rng.choice(others)]
    return T[true], matched, kind == "right"
