"""Bodies in front of the wall: stones that lie on it and an instrument beside the lens, as solids with shadows.

Stones are rough ellipsoids, instruments thin cylinders; both are met by rays in closed form, so that they cover what
lies behind them and keep light from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import Array
from ursnav_torch.rendering.sensor.noise import noise_and_slope, solid_noise
from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Surface
from ursnav_torch.rendering.sensor.wall import PaintedWall

#: What a pixel shows, as `Seen.kind` and the labels of `simulate_labeled` have it.
WALL, STONE, INSTRUMENT, CLUTTER = 0, 1, 2, 3
#: A stone keeps this far from the lens, mm, times its radius: nearer ones fill the picture.
_ROOM = 1.2
#: Tries to find a stone a place.
_TRIES = 12


@dataclass(frozen=True, slots=True)
class BodyFaults:
    """Stones and an instrument. Lengths in mm."""

    stones: int = setting(0, 0, 6, "stones and fragments in sight; 1-3 of a lower pole is usual, dusting leaves many")
    stone_mm: float = choice(1.5, "radius of a large one; 0.3-5 mm: fragments from 0.6 mm, stones to 10 mm across")
    stone_bgr: tuple[float, float, float] = choice(
        (0.55, 0.75, 0.85), "reflectance: pale and yellow (calcium), brown or black (oxalate), orange (uric acid)"
    )
    stone_bumps: float = setting(0.0, 0, 0.5, "roughness of their surface: smooth (uric acid) to mulberry and spicules")
    stone_long: float = choice(1.3, "longest by shortest axis; 1-2.5")
    instrument_mm: float = setting(0.0, 0, 14, "how far ahead of the lens a fiber, guidewire or basket ends")
    instrument_radius_mm: float = choice(0.2, "0.1 (bare 200 um fiber) to 0.6 mm (3.6 F basket sheath)")
    instrument_angle_rad: float = choice(0.0, "around the optical axis, where the working channel ends")
    instrument_beside_mm: float = choice(1.2, "of the channel from the lens; 0.8-2 mm in a 7.5-9.5 F tip")
    instrument_lean: float = choice(0.1, "how far it leans to the axis, as share of the way; -0.1-0.4")
    instrument_bgr: tuple[float, float, float] = choice((0.8, 0.5, 0.2), "blue or green jacket, clear, or steel")
    instrument_rings: float = setting(0.0, 0, 0.8, "contrast of a guidewire's windings")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class Stone:
    """A stone in the kidney.

    Attributes:
        center_mm: (3,) kidney frame.
        radii_mm: (3,) half axes.
        R_kidney_stone: (3, 3) the axes' directions.
        bgr: reflectance.
        bumps: roughness, see `BodyFaults.stone_bumps`.
        seed: of the bumps.
    """

    center_mm: Array
    radii_mm: Array
    R_kidney_stone: Array
    bgr: tuple[float, float, float]
    bumps: float
    seed: int


@dataclass(frozen=True, slots=True)
class Seen:
    """A picture's surface with the bodies before it.

    Attributes:
        surface: as `surface_of` gives it, bodies included.
        wall: its paint, bodies included.
        kind: (N,) uint8, `WALL`, `STONE` or `INSTRUMENT`.
        lit: (N,) share of the light's direct beam that no body takes.
    """

    surface: Surface
    wall: PaintedWall
    kind: np.ndarray
    lit: Floats


def place_stones(surface: Surface, T_kidney_camera: Array, faults: BodyFaults, rng: np.random.Generator) -> list[Stone]:
    """Stones that lie on the wall in sight of a camera at ``T_kidney_camera`` (4, 4)."""
    found: list[Stone] = []
    for _ in range(faults.stones):
        shape = np.array([1.0, rng.uniform(0.8, 1.1), rng.uniform(1.0, max(faults.stone_long, 1.0))])
        radii = faults.stone_mm * rng.uniform(0.35, 1.0) * shape
        for _ in range(_TRIES):
            at = rng.integers(len(surface.pixels))
            if surface.distance_mm[at] > (2 + _ROOM) * radii.max():
                break
        else:
            continue
        inward = surface.R_kidney_camera @ surface.normals[at]
        center = surface.points_kidney[at] + inward * radii.min() * rng.uniform(0.6, 1.0)
        found.append(
            Stone(center.astype(float), radii, Rotation.random(rng=rng).as_matrix(), faults.stone_bgr,
                  faults.stone_bumps, int(rng.integers(2**30)))
        )  # fmt: skip
    return found


def with_bodies(
    surface: Surface,
    wall: PaintedWall,
    T_kidney_camera: Array,
    faults: BodyFaults,
    stones: Sequence[Stone],
    light_camera_mm: Floats,
) -> Seen:
    """The surface with bodies before it, and what of the light of a lamp at ``light_camera_mm`` (3,) is left."""
    kind = np.zeros(len(surface.pixels), np.uint8)
    lit = np.ones(len(surface.pixels), np.float32)
    if not stones and faults.instrument_mm <= 0:
        return Seen(surface, wall, kind, lit)
    distance, normals = surface.distance_mm.copy(), wall.normals.copy()
    color, wetness = wall.color.copy(), wall.wetness.copy()
    zero = np.zeros(3, np.float32)
    for stone in stones:
        A, center = _unit_sphere(stone, T_kidney_camera)
        t = _ray_sphere(zero, surface.rays, A, center)
        hit = t < distance
        if not hit.any():
            continue
        points = surface.rays[hit] * t[hit, None]
        normals[hit], color[hit] = _stone_skin(stone, points, A, center, T_kidney_camera)
        distance[hit], kind[hit], wetness[hit] = t[hit], STONE, 0.3
    if faults.instrument_mm > 0:
        a, b = _axis(faults)
        t, along, normal = _ray_cylinder(zero, surface.rays, a, b, faults.instrument_radius_mm)
        hit = t < distance
        rings = 1 - faults.instrument_rings * (np.sin(2 * np.pi * along[hit] / 0.35) > 0)
        distance[hit], kind[hit], normals[hit], wetness[hit] = t[hit], INSTRUMENT, normal[hit], 1.0
        color[hit] = rings[:, None] * np.array(faults.instrument_bgr, np.float32)
    points = np.asarray(surface.rays * distance[:, None], np.float32)
    lit = _lit(points, light_camera_mm, stones, faults, T_kidney_camera)
    R, t0 = T_kidney_camera[:3, :3].astype(np.float32), T_kidney_camera[:3, 3].astype(np.float32)
    solid = replace(
        surface, distance_mm=distance, normals=normals, points_kidney=np.asarray(points @ R.T + t0, np.float32)
    )
    return Seen(solid, PaintedWall(color, normals, wetness), kind, lit)


def _unit_sphere(stone: Stone, T_kidney_camera: Array) -> tuple[Floats, Floats]:
    """The matrix (3, 3) that makes the stone, in the camera frame, a unit sphere, and its center (3,) there."""
    R = T_kidney_camera[:3, :3]
    center = R.T @ (stone.center_mm - T_kidney_camera[:3, 3])
    A = np.diag(1 / stone.radii_mm) @ stone.R_kidney_stone.T @ R
    return A.astype(np.float32), center.astype(np.float32)


def _ray_sphere(origins: Floats, rays: Floats, A: Floats, center: Floats) -> Floats:
    """Distances (N,) along unit rays (N, 3) from origins (3,) or (N, 3) to an ellipsoid, inf where it is missed."""
    o, d = (origins - center) @ A.T, rays @ A.T
    a, b = np.einsum("ij,ij->i", d, d), np.einsum("...j,...j->...", o, d)
    c = np.einsum("...j,...j->...", o, o) - 1
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    return np.where((root > 0) & (t > 1e-3), t, np.inf).astype(np.float32)


def _ray_cylinder(origins: Floats, rays: Floats, a: Floats, b: Floats, radius: float) -> tuple[Floats, Floats, Floats]:
    """Distances (N,) to a thin cylinder from a to b (3,), where along it (N,) mm, and its normals there (N, 3)."""
    axis = b - a
    length = float(np.linalg.norm(axis))
    axis = axis / np.float32(length)
    w = np.broadcast_to(origins - a, rays.shape)
    da, wa = rays @ axis, w @ axis
    dp, wp = rays - da[:, None] * axis, w - wa[:, None] * axis
    qa, qb = np.einsum("ij,ij->i", dp, dp), np.einsum("ij,ij->i", dp, wp)
    qc = np.einsum("ij,ij->i", wp, wp) - radius**2
    root = qb * qb - qa * qc
    t = (-qb - np.sqrt(np.maximum(root, 0))) / np.maximum(qa, 1e-9)
    along = wa + t * da
    hit = (root > 0) & (t > 1e-3) & (along > 0) & (along < length)
    normal = (wp + t[:, None] * dp) / np.float32(radius)
    return np.where(hit, t, np.inf).astype(np.float32), along.astype(np.float32), normal.astype(np.float32)


def _axis(faults: BodyFaults) -> tuple[Floats, Floats]:
    """The instrument's two ends (3,), camera frame."""
    side = np.array([np.cos(faults.instrument_angle_rad), np.sin(faults.instrument_angle_rad), 0], np.float32)
    beside = np.float32(faults.instrument_beside_mm)
    tip = side * beside * np.float32(1 - faults.instrument_lean * 3)
    tip[2] = faults.instrument_mm
    return side * beside, tip


def _stone_skin(
    stone: Stone, points: Floats, A: Floats, center: Floats, T_kidney_camera: Array
) -> tuple[Floats, Floats]:
    """Normals (N, 3), camera frame, and colors (N, 3) of a stone at points (N, 3), camera frame."""
    local = points - center
    normal = np.asarray((local @ A.T) @ A, np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    size = float(stone.radii_mm.min())
    anchored = local @ T_kidney_camera[:3, :3].T.astype(np.float32)
    if stone.bumps > 0:
        _, slope = noise_and_slope(anchored, 0.5 * size, stone.seed)
        slope = slope @ T_kidney_camera[:3, :3].astype(np.float32)
        slope -= np.einsum("ij,ij->i", slope, normal)[:, None] * normal
        normal = np.asarray(normal - np.float32(stone.bumps) * slope, np.float32)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    patches = np.exp(0.25 * np.clip(solid_noise(anchored, 0.8 * size, stone.seed + 1), -2, 2))
    return normal, np.asarray(patches[:, None] * np.array(stone.bgr, np.float32), np.float32)


def _lit(points: Floats, light: Floats, stones: Sequence[Stone], faults: BodyFaults, T_kidney_camera: Array) -> Floats:
    """Share (N,) of the light at ``light`` (3,) that reaches points (N, 3), all in the camera frame."""
    towards = points - light
    far = np.linalg.norm(towards, axis=1)
    towards = towards / np.maximum(far, 1e-6)[:, None]
    free = np.ones(len(points), np.float32)
    for stone in stones:
        t = _ray_sphere(light, towards, *_unit_sphere(stone, T_kidney_camera))
        free[t < far - 0.05] = 0.15  # a lamp has a size, and the wall scatters: no shadow is black
    if faults.instrument_mm > 0:
        t, _, _ = _ray_cylinder(light, towards, *_axis(faults), faults.instrument_radius_mm)
        free[t < far - 0.05] *= 0.4
    return free
