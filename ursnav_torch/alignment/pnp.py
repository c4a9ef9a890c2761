"""Pose from edge points: shape-context correspondences give 2-D to 3-D pairs, robust PnP on viewing rays the pose.

RANSAC (Fischler and Bolles 1981) over three-point poses, then Levenberg-Marquardt on the angles between rays with
Cauchy weights. Rays instead of pixels, so that any lens will do, beyond 180 degrees too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from torch import Tensor

from ursnav_torch.errors import ShapeError
from ursnav_torch.features import EdgePoints
from ursnav_torch.geometry import Array, apply, inverse, transform_from
from ursnav_torch.matching import Hungarian, Matcher
from ursnav_torch.search import Ranking, default_matching
from ursnav_torch.search.shape import turn_edges
from ursnav_torch.vid import Vid

#: Three points fix a pose up to four ways, the fourth decides; more make it sure.
LEAST_POINTS = 6
#: Share of a point's mass that must go to one point of the view, for the two to be a pair.
LEAST_STRENGTH = 0.3


@dataclass(frozen=True, slots=True)
class PnpSettings:
    """How a pose is found from pairs.

    Attributes:
        tries: three-point poses drawn.
        inlier: largest angle in radians between where a point is seen and where it should be, to agree with a pose.
        seed: of the draws; the same pairs give the same pose.
    """

    tries: int = 120
    inlier: float = 0.09
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Pnp:
    """A pose from N pairs.

    Attributes:
        T_kidney_camera: (4, 4).
        inliers: (N,) bool, pairs that agree with it.
    """

    T_kidney_camera: Array
    inliers: NDArray[np.bool_]


def solve_pnp(
    points_kidney: ArrayLike,
    rays_camera: ArrayLike,
    settings: PnpSettings | None = None,
    T_kidney_guess: Array | None = None,
) -> Pnp | None:
    """The pose from which points (N, 3) in the kidney frame, mm, are seen along unit rays (N, 3), some pairs wrong.

    Args:
        points_kidney: wall points; rows with nan count for nothing.
        rays_camera: where each is seen.
        settings: how hard to try.
        T_kidney_guess: (4, 4) a pose that takes part as one more try.

    Returns:
        None where no pose agrees with `LEAST_POINTS` pairs.

    Raises:
        ShapeError: the two differ in number, or are not (N, 3).
    """
    points, rays = np.asarray(points_kidney, float), np.asarray(rays_camera, float)
    if points.ndim != 2 or points.shape != rays.shape or points.shape[1] != 3:
        raise ShapeError(f"Expected points (N, 3) and rays (N, 3), got {points.shape} and {rays.shape}.")
    settings = settings or PnpSettings()
    known = np.flatnonzero(np.isfinite(points).all(1))
    points, rays = points[known], rays[known]
    if len(known) < LEAST_POINTS:
        return None
    T = _consensus(points, rays, settings, T_kidney_guess)
    for _ in range(2):
        agree = _angles(T, points, rays) < settings.inlier
        if agree.sum() < LEAST_POINTS:
            return None
        T = _polish(T, points[agree], rays[agree], settings.inlier / 3)
    inliers = np.zeros(len(np.asarray(points_kidney)), bool)
    inliers[known] = _angles(T, points, rays) < settings.inlier
    return Pnp(inverse(T), inliers)


def pose_from_correspondences(
    vid: Vid, edges: EdgePoints, view: int, view_point: Tensor, T_kidney_guess: Array, settings: PnpSettings
) -> Pnp | None:
    """The pose of a picture whose edge points were matched with those of a view, which know their places on the wall.

    Args:
        vid: its lens, and its views' points in the kidney.
        edges: of the picture, N points.
        view: row of the VID.
        view_point: (N,) int64 the view's point for each of them.
        T_kidney_guess: (4, 4) where the search has the picture.
        settings: of the solver.

    Returns:
        None where no pose agrees with `LEAST_POINTS` pairs.
    """
    seen, _ = vid.camera.rays(edges.points.numpy().astype(float))
    wall = vid.features.points_kidney[view, view_point].numpy().astype(float)
    return solve_pnp(wall, seen, settings, T_kidney_guess)


def starts_from(vid: Vid, edges: EdgePoints, found: Ranking, rows: Sequence[int], settings: PnpSettings) -> list[Array]:
    """Poses (4, 4) that the correspondences of a search's hypotheses give, at those rows that give one.

    Args:
        vid, edges, settings: as `pose_from_correspondences` has them.
        found: what `ViewSearch.rank` gave, with the assignment of the picture's points to each view's.
        rows: of the hypotheses.
    """
    if found.assignment is None:
        return []
    poses = []
    for row in rows:
        kept = (found.assignment.strength[row] >= LEAST_STRENGTH).nonzero().flatten()
        view_point = found.assignment.view_point[row, kept]
        guess = found.T_kidney_camera[row]
        solved = pose_from_correspondences(vid, edges.subset(kept), int(found.views[row]), view_point, guess, settings)
        if solved is not None:
            poses.append(solved.T_kidney_camera)
    return poses


class EdgePnp:
    """Poses of pictures near a known place, from the VID's nearest view: edges are matched one to one, then solved.

    Args:
        vid: its views' edge points know their places on the wall.
        settings: of the solver.
    """

    def __init__(self, vid: Vid, settings: PnpSettings | None = None) -> None:
        self._vid, self._settings = vid, settings or PnpSettings()
        f = vid.features
        self._matcher = Matcher(f.points, f.mask, f.direction, replace(default_matching(), method=Hungarian()))

    def pose(self, edges: EdgePoints, view: int, T_kidney_candidate: Array) -> Pnp | None:
        """The pose of a picture with these edges, whose best view and pose (4, 4) the localizer found.

        The picture is turned to that view's rotation for matching, as the localizer turns it.
        """
        R_view_query = self._vid.T_kidney_camera[view, :3, :3].T @ T_kidney_candidate[:3, :3]
        points, direction = turn_edges(edges, self._vid.camera, R_view_query[None])
        found = self._matcher.assign(points, direction, torch.tensor([view]))
        kept = (found.strength[0] >= LEAST_STRENGTH).nonzero().flatten()
        return pose_from_correspondences(
            self._vid, edges.subset(kept), view, found.view_point[0, kept], T_kidney_candidate, self._settings
        )


def _consensus(points: Array, rays: Array, settings: PnpSettings, T_kidney_guess: Array | None) -> Array:
    """The T_camera_kidney (4, 4) with which most pairs agree; pairs count more the better they do (MSAC)."""
    rng = np.random.default_rng(settings.seed)
    tries = [] if T_kidney_guess is None else [inverse(T_kidney_guess)]
    for _ in range(settings.tries):
        three = rng.choice(len(points), 3, replace=False)
        tries += _three_point_poses(points[three], rays[three])
    if not tries:
        return np.eye(4)
    cost = [np.minimum(_angles(T, points, rays) / settings.inlier, 1) ** 2 for T in tries]
    return tries[int(np.argmin(np.sum(cost, axis=1)))]


def _three_point_poses(points: Array, rays: Array) -> list[Array]:
    """Up to four T_camera_kidney that put points (3, 3) on rays (3, 3).

    Solved in a camera that looks along the rays' mean, where all three have an image on a plane.
    """
    axis = rays.mean(0)
    if np.linalg.norm(axis) < 0.2:
        return []
    R_turned_camera = Rotation.align_vectors([[0.0, 0.0, 1.0]], axis[None])[0].as_matrix()
    turned = rays @ R_turned_camera.T
    if turned[:, 2].min() < 0.05:
        return []
    _, rotations, shifts = cv2.solveP3P(
        points[:, None], (turned[:, :2] / turned[:, 2:])[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_AP3P
    )
    T_camera_turned = transform_from(R_turned_camera.T, np.zeros(3))
    turns = [Rotation.from_rotvec(r[:, 0]).as_matrix() for r in rotations]
    return [T_camera_turned @ transform_from(R, t[:, 0]) for R, t in zip(turns, shifts, strict=True)]


def _angles(T_camera_kidney: Array, points: Array, rays: Array) -> Array:
    """Angles (N,) between where points (N, 3) are and where they are seen."""
    return 2 * np.arcsin(np.linalg.norm(_off(T_camera_kidney, points, rays), axis=1).clip(0, 2) / 2)


def _off(T_camera_kidney: Array, points: Array, rays: Array) -> Array:
    """Differences (N, 3) of unit rays: computed less seen."""
    there = apply(T_camera_kidney, points)
    return there / np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-9) - rays


def _polish(T_camera_kidney: Array, points: Array, rays: Array, size: float) -> Array:
    """The pose nearby with the least robust sum of squared angles."""

    def moved(x: Array) -> Array:
        return transform_from(Rotation.from_rotvec(x[:3]).as_matrix(), x[3:]) @ T_camera_kidney

    fit = least_squares(lambda x: _off(moved(x), points, rays).ravel(), np.zeros(6), loss="cauchy", f_scale=size,
                        max_nfev=30)  # fmt: skip
    return moved(fit.x)
