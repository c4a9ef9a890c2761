"""A ball from its cones of sight: where they meet, how wide they are, and that it touches the wall.

One cone leaves the depth open; the wall closes it, as a stone lies on it. More cones meet by parallax, and grow as the
lens comes nearer. All of it is one nonlinear least-squares problem of four unknowns, the middle and the radius (bundle
adjustment of one point with known cameras: Triggs et al. 2000, here with apparent sizes and contact besides).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ursnav_torch.geometry import Array
from ursnav_torch.stones.settings import StoneMapSettings

Clearance = Callable[[Array], Array]
_STEP_MM = 0.1
#: A ball may seem to reach into the wall by this share of its radius: neither its outline nor the wall is sharp.
_SUNK = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Cones:
    """N cones of sight in the kidney frame.

    Attributes:
        origin_mm: (N, 3) where the lens stood.
        ray: (N, 3) unit, to the middle.
        half_angle: (N,) radians.
        is_whole: (N,) bool; of the others the angle is a least one.
        position_sd_mm, direction_sd: (N,) of the pose: mm, radians.
    """

    origin_mm: Array
    ray: Array
    half_angle: Array
    is_whole: np.ndarray
    position_sd_mm: Array
    direction_sd: Array


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """A stone's place and size.

    Attributes:
        center_mm: (3,) kidney frame.
        radius_mm: of the ball that looks as large.
        covariance: (4, 4) of the center in mm and of the radius's natural logarithm.
    """

    center_mm: Array
    radius_mm: float
    covariance: Array

    @property
    def position_sd_mm(self) -> float:
        """Standard deviation of the place along the worst axis, mm."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))


def contact_depth_mm(origin: Array, ray: Array, half_angle: float, clearance: Clearance, farthest: float) -> float:
    """Distance in mm along a ray at which a ball of an apparent radius (radians) touches the wall behind it.

    Args:
        origin, ray: (3,) kidney frame; the ray is a unit vector.
        half_angle: radians.
        clearance: distance to the wall (N,) of points (N, 3), negative behind it.
        farthest: mm; nothing is looked for beyond.
    """
    depth = np.arange(_STEP_MM, farthest + _STEP_MM, _STEP_MM)
    room = clearance(origin + depth[:, None] * ray)
    behind = np.flatnonzero(room < 0)
    end = int(behind[0]) if len(behind) else len(depth)
    radius = depth * np.sin(half_angle)
    gap = (room - radius)[: max(end, 1)]
    fits = np.flatnonzero(gap >= -_SUNK * radius[: len(gap)])
    if not len(fits):
        return float(depth[int(gap.argmax())])
    last = fits[np.flatnonzero(np.diff(fits, prepend=-2) > 1)[-1] :][0]  # where the deepest stretch begins
    free = np.flatnonzero(gap[last : fits[-1] + 1] >= 0)
    return float(depth[last + (free[-1] if len(free) else int(gap[last : fits[-1] + 1].argmax()))])


def fit_ball(cones: Cones, clearance: Clearance, settings: StoneMapSettings, start: Ball | None = None) -> Ball:
    """The ball that explains its cones of sight.

    Args:
        cones: at least one.
        clearance: see `contact_depth_mm`.
        settings: standard deviations; lengths in mm of this kidney.
        start: where to begin; where the clearest cone touches the wall when None.
    """
    s = settings
    if start is None:
        start = _touching(cones, clearance, s)
    spread = np.sqrt(max(1.0, min(s.alike, len(cones.ray))))
    # The middle of what is seen of a stone is not its own.
    bearing = np.hypot(np.radians(s.bearing_deg), np.where(cones.is_whole, 0.0, cones.half_angle))
    side = _sideways(cones.ray)

    def residuals(unknown: Array) -> Array:
        way = unknown[:3] - cones.origin_mm
        distance = np.maximum(np.linalg.norm(way, axis=1), 1e-3)
        radius = np.exp(unknown[3])
        sd = np.sqrt(bearing**2 + cones.direction_sd**2 + (cones.position_sd_mm / distance) ** 2) * spread
        aside = np.einsum("nij,nj->ni", side, way / distance[:, None]) / sd[:, None]
        seen = np.arcsin(np.clip(radius / distance, 0, 0.99))
        wider = np.log(seen / cones.half_angle) / (s.angle_share * spread)
        wider = np.where(cones.is_whole, wider, np.minimum(wider, 0.0))
        gap = (float(clearance(unknown[None, :3])[0]) - radius) / (s.contact_mm + s.contact_share * radius)
        return np.concatenate([aside.ravel(), wider, [gap]])

    first = np.append(start.center_mm, np.log(start.radius_mm))
    found = least_squares(residuals, first, loss="soft_l1", f_scale=1.5, x_scale=(1, 1, 1, 0.3), max_nfev=40)
    information = found.jac.T @ found.jac + np.diag([1e-3, 1e-3, 1e-3, 1.0])
    return Ball(found.x[:3], float(np.exp(found.x[3])), np.linalg.inv(information))


def _touching(cones: Cones, clearance: Clearance, s: StoneMapSettings) -> Ball:
    """The ball of the cone that shows most, on the wall."""
    best = int(np.argmax(cones.half_angle * np.where(cones.is_whole, 1.0, 0.5)))
    origin, ray, half = cones.origin_mm[best], cones.ray[best], float(cones.half_angle[best])
    depth = contact_depth_mm(origin, ray, half, clearance, s.farthest_mm)
    return Ball(origin + depth * ray, max(depth * np.sin(half), 0.2), np.eye(4))


def _sideways(ray: Array) -> Array:
    """(N, 2, 3) two unit vectors across each ray (N, 3)."""
    helper = np.where(np.abs(ray[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    a = np.cross(ray, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, np.cross(ray, a)], axis=1)
