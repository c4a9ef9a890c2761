"""Lens models as functions of a lens: viewing rays <-> offsets from the principal point in focal lengths.

``project(k, p)`` takes points (..., 3) and gives offsets (..., 2) and whether the model holds there (...);
``unproject(k, q)`` is its inverse and gives directions (..., 3) of length 1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Found = tuple[Array, NDArray[np.bool_]]
K = tuple[float, ...]

#: OCamCalib's polynomials are looked at up to so many focal lengths from the center.
_OCAM_END = 8.0


@dataclass(frozen=True, slots=True)
class LensModel:
    """One model: its two functions, how many ``k`` it takes (None: see there), and the words for them."""

    project: Callable[[K, Array], Found]
    unproject: Callable[[K, Array], Found]
    coefficients: range
    words: str


def radial(angle: Array, k: K) -> Array:
    """Kannala and Brandt's radius (...) in focal lengths at angles (...) from the axis, radians.

    IEEE TPAMI 28:1335, 2006, as OpenCV's fisheye has it.
    """
    t2 = angle * angle
    k1, k2, k3, k4 = k
    return np.asarray(angle * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


@lru_cache(maxsize=64)
def fold_angle(k: K) -> float:
    """The angle (radians) up to which Kannala and Brandt's radius rises; pi where it does all the way."""
    if not any(k):
        return math.pi
    angle = np.linspace(0, math.pi, 2000)
    falls = np.flatnonzero(np.diff(radial(angle, k)) <= 0)
    return float(angle[falls[0]]) if len(falls) else math.pi


def _equidistant(k: K, p: Array) -> Found:
    r = np.hypot(p[..., 0], p[..., 1])
    angle = np.arctan2(r, p[..., 2])
    scale = radial(angle, k) / np.maximum(r, 1e-12)  # on the axis x and y are nothing, too
    return p[..., :2] * scale[..., None], ((r > 0) | (p[..., 2] > 0)) & (angle <= fold_angle(k))


def equidistant_offsets(k: K, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Offsets (2, ...) of points (3, ...) in an equidistant lens, wherever they lie: numbers of one kind together,
    which is what is fast."""
    x, y, z = points
    r = np.sqrt(x * x + y * y)
    angle = np.arctan2(r, z)
    scale = radial(angle, k) if any(k) else angle
    return np.asarray(points[:2] * (scale / np.maximum(r, np.float32(1e-12))), np.float32)


def _from_equidistant(k: K, q: Array) -> Found:
    r = np.hypot(q[..., 0], q[..., 1])
    end = fold_angle(k)
    grid = np.linspace(0, end, 2000)
    angle = np.interp(r, radial(grid, k), grid)
    k1, k2, k3, k4 = k
    for _ in range(6):  # Newton
        t2 = angle * angle
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        angle = np.clip(angle - (radial(angle, k) - r) / np.where(slope > 0.02, slope, 0.02), 0, end)
    return _along(q, angle, r), r <= radial(np.array(end), k) + 1e-9


def _along(q: Array, angle: Array, r: Array) -> Array:
    by_r = np.where(r > 1e-12, np.sin(angle) / np.where(r > 1e-12, r, 1.0), 1.0)
    return np.stack([q[..., 0] * by_r, q[..., 1] * by_r, np.cos(angle)], axis=-1)


def _pinhole(k: K, p: Array) -> Found:
    ok = p[..., 2] > 1e-9
    return p[..., :2] / np.where(ok, p[..., 2], 1.0)[..., None], ok


def _from_pinhole(k: K, q: Array) -> Found:
    ray = np.concatenate([q, np.ones((*q.shape[:-1], 1))], axis=-1)
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True), np.ones(q.shape[:-1], bool)


def distorted(q: Array, k: K) -> tuple[Array, Array]:
    """Brown and Conrady's distortion of undistorted offsets (..., 2), as OpenCV has it, and its Jacobian (..., 2, 2).

    ``k`` is k1, k2, p1, p2, k3, k4, k5, k6; the last three stand below the fraction line.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    x, y = q[..., 0], q[..., 1]
    s = x * x + y * y
    above, below = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
    g = above / below
    dg = ((k1 + s * (2 * k2 + s * 3 * k3)) - g * (k4 + s * (2 * k5 + s * 3 * k6))) / below  # by s
    u = x * g + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * g + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    J = np.empty((*q.shape, 2))
    J[..., 0, 0] = g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x
    J[..., 0, 1] = J[..., 1, 0] = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
    J[..., 1, 1] = g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x
    return np.stack([u, v], axis=-1), J


def _rational(k: K, p: Array) -> Found:
    q, ok = _pinhole(k, p)
    return distorted(q, k)[0], ok


def _from_rational(k: K, q: Array) -> Found:
    found = q.copy()
    for _ in range(30):  # damped Newton
        value, J = distorted(found, k)
        det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
        det = np.where(np.abs(det) > 1e-6, det, 1e-6)
        off = q - value
        step = np.stack(
            [J[..., 1, 1] * off[..., 0] - J[..., 0, 1] * off[..., 1],
             J[..., 0, 0] * off[..., 1] - J[..., 1, 0] * off[..., 0]], axis=-1) / det[..., None]  # fmt: skip
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        found = found + step * np.minimum(1.0, 0.3 / np.maximum(length, 1e-12))
    value, J = distorted(found, k)
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    ok = (np.linalg.norm(value - q, axis=-1) < 1e-6) & (det > 0)
    return _from_pinhole(k, found)[0], ok


def _ocam(k: K, p: Array) -> Found:
    """Scaramuzza's polynomial (OCamCalib): IROS 2006. ``k`` is c, d, e, a0, a1, ... in focal lengths; x is down."""
    c, d, e, *a = k
    end = ocam_reach(k)
    grid = np.linspace(0, end, 4000)
    value = np.polynomial.polynomial.polyval(grid, a)
    r = np.hypot(p[..., 0], p[..., 1])
    angle = np.arctan2(r, p[..., 2])
    angles = np.arctan2(grid, -value)
    rho = np.interp(angle, angles, grid)
    slope = np.polynomial.polynomial.polyder(a)
    for _ in range(4):  # Newton
        z = np.polynomial.polynomial.polyval(rho, a)
        rise = (rho * np.polynomial.polynomial.polyval(rho, slope) - z) / np.maximum(rho**2 + z**2, 1e-9)
        rho = np.clip(rho - (np.arctan2(rho, -z) - angle) / np.where(rise > 1e-9, rise, 1e-9), 0, end)
    across, down = (p[..., i] * rho / np.maximum(r, 1e-12) for i in (0, 1))
    return np.stack([down * e + across, down * c + across * d], axis=-1), angle <= angles[-1]


def _from_ocam(k: K, q: Array) -> Found:
    c, d, e, *a = k
    u, v = q[..., 0], q[..., 1]
    down, across = (v - d * u) / (c - d * e), (c * u - e * v) / (c - d * e)
    rho = np.hypot(down, across)
    ray = np.stack([across, down, -np.polynomial.polynomial.polyval(rho, a)], axis=-1)
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True), rho <= ocam_reach(k)


def ocam_reach(k: K) -> float:
    """The offset from the center, in focal lengths, up to which OCamCalib's polynomial looks farther out."""
    _, _, _, *a = k
    rho = np.linspace(0, _OCAM_END, 8000)
    falls = np.flatnonzero(np.diff(np.arctan2(rho, -np.polynomial.polynomial.polyval(rho, a))) <= 0)
    return float(rho[falls[0]]) if len(falls) else float(rho[-1])


def _double_sphere(k: K, p: Array) -> Found:
    """Usenko, Demmel and Cremers, 3DV 2018; with alpha 0 it is Mei's unified model."""
    xi, alpha = k
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    d1 = np.linalg.norm(p, axis=-1)
    d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    w2 = (w1 + xi) / math.sqrt(2 * w1 * xi + xi * xi + 1)
    below = alpha * d2 + (1 - alpha) * (xi * d1 + z)
    ok = (z > -w2 * d1) & (below > 1e-9)
    return p[..., :2] / np.where(ok, below, 1.0)[..., None], ok


def _from_double_sphere(k: K, q: Array) -> Found:
    xi, alpha = k
    s = np.sum(q * q, axis=-1)
    root = 1 - (2 * alpha - 1) * s
    ok = (root >= 0) if alpha > 0.5 else np.ones(s.shape, bool)
    z = (1 - alpha * alpha * s) / (alpha * np.sqrt(np.maximum(root, 0)) + 1 - alpha)
    inner = z * z + (1 - xi * xi) * s
    ok = ok & (inner >= 0)
    scale = (z * xi + np.sqrt(np.maximum(inner, 0))) / np.maximum(z * z + s, 1e-12)
    ray = np.concatenate([scale[..., None] * q, (scale * z - xi)[..., None]], axis=-1)
    return ray / np.maximum(np.linalg.norm(ray, axis=-1, keepdims=True), 1e-12), ok


#: Every model by the name that camera JSON has for it.
MODELS = {
    "equidistant": LensModel(_equidistant, _from_equidistant, range(4, 5), "k1, k2, k3, k4"),
    "pinhole": LensModel(_pinhole, _from_pinhole, range(0, 5), "none"),
    "rational": LensModel(_rational, _from_rational, range(8, 9), "k1, k2, p1, p2, k3, k4, k5, k6"),
    "ocam": LensModel(_ocam, _from_ocam, range(5, 16), "c, d, e, a0, a1, ..."),
    "double_sphere": LensModel(_double_sphere, _from_double_sphere, range(2, 3), "xi, alpha"),
}
