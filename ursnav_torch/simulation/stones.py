"""Stones in a simulated kidney: solids that touch its wall, cross neither it nor one another, and stop the scope."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering.sensor import Stone
from ursnav_torch.scaling import scaled

#: Directions in which a stone's surface is asked for its distance to the wall.
_SURFACE = Rotation.random(256, rng=0).apply([0.0, 0.0, 1.0])
#: Tries to find a stone a place.
_TRIES = 60


@dataclass(frozen=True, slots=True)
class StoneSettings:
    """What stones there are; mm at the kidney's scale 1.

    Attributes:
        smallest_mm, largest_mm: longest diameters, drawn evenly in their logarithm; endoscopy treats stones of up to
            20 mm, and fragments above 2 mm are counted as residual (EAU guideline on urolithiasis, 2024).
        long: longest by shortest axis, at most.
        bumps: roughness, at most, see `Stone`.
        darkest_bgr, palest_bgr: reflectance, drawn between: brown oxalate to pale calcium.
        lower: times as many in the lower pole as elsewhere, a calyx.
        apart_mm: between two stones, and between a stone and the place where the scope starts.
    """

    smallest_mm: float = 2.0
    largest_mm: float = 8.0
    long: float = 1.6
    bumps: float = 0.3
    darkest_bgr: tuple[float, float, float] = (0.1, 0.25, 0.3)
    palest_bgr: tuple[float, float, float] = (1.0, 1.0, 1.1)
    lower: float = 2.0
    apart_mm: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.smallest_mm <= self.largest_mm or self.long < 1 or self.lower <= 0:
            raise InputError(
                "Stones need 0 < smallest_mm <= largest_mm, long >= 1 and lower > 0, got "
                f"{self.smallest_mm}, {self.largest_mm}, {self.long} and {self.lower}."
            )


def lay_stones(
    kidney: Kidney, lumen: LumenDistance, count: int, rng: np.random.Generator, settings: StoneSettings | None = None
) -> tuple[Stone, ...]:
    """Stones on the wall of some calyces, each at its own place.

    Args:
        kidney, lumen: where.
        count: how many; fewer where a place cannot be found.
        rng: draws calyces, sizes, shapes and places.
        settings: what stones there are.
    """
    s = scaled(settings or StoneSettings(), kidney.scale)
    weight = np.array([s.lower if c.pole == "lower" else 1.0 for c in kidney.calyces])
    to_tips = lumen.to_calyces(lumen.grid.centers_mm)
    found: list[Stone] = []
    for _ in range(count):
        calyx = int(rng.choice(len(weight), p=weight / weight.sum()))
        room = lumen.grid.centers_mm[(to_tips.argmin(1) == calyx) & (to_tips[:, calyx] < 9.0 * kidney.scale)]
        for _ in range(_TRIES):
            stone = _on_wall(lumen, _drawn(room[rng.integers(len(room))], s, rng), rng)
            if stone is not None and _is_free(stone, found, kidney.centerline.points_mm[0], s.apart_mm):
                found.append(stone)
                break
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class ObstructedLumen:
    """A lumen with stones in it: what a scope feels.

    Attributes:
        lumen: without them.
        stones: what lies in it.
    """

    lumen: LumenDistance
    stones: tuple[Stone, ...]

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance in mm from points (N, 3), kidney frame, to wall or stone, at most; negative inside them."""
        return np.minimum(self.lumen.clearance_mm(points_mm), self.to_stones_mm(points_mm))

    def to_stones_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance in mm from points (N, 3), kidney frame, to the nearest stone; inf where there is none."""
        points = np.asarray(points_mm, float).reshape(-1, 3)
        free = np.full(len(points), np.inf)
        for stone in self.stones:
            free = np.minimum(free, distance_to_stone(stone, points))
        return free


def distance_to_stone(stone: Stone, points_mm: Array) -> Array:
    """(N,) distance in mm from points (N, 3), kidney frame, to a stone: exact for a ball, else never too large."""
    local = (points_mm - stone.center_mm) @ stone.R_kidney_stone / stone.radii_mm
    return np.asarray((np.linalg.norm(local, axis=1) - 1) * stone.radii_mm.min(), float)


def _drawn(center: Array, s: StoneSettings, rng: np.random.Generator) -> Stone:
    """A stone of a random size and shape around a place."""
    shape = np.array([1.0, rng.uniform(0.8, 1.1), rng.uniform(1.0, s.long)])
    longest = s.smallest_mm * (s.largest_mm / s.smallest_mm) ** rng.random()
    color = rng.uniform(s.darkest_bgr, s.palest_bgr)
    return Stone(
        np.asarray(center, float), shape / shape.max() * longest / 2, Rotation.random(rng=rng).as_matrix(),
        tuple(color.tolist()), float(rng.uniform(0, s.bumps)), int(rng.integers(2**30)),
    )  # fmt: skip


def _on_wall(lumen: LumenDistance, stone: Stone, rng: np.random.Generator) -> Stone | None:
    """The stone moved until it touches the nearest wall; None where it does not fit."""
    rim = (_SURFACE * stone.radii_mm) @ stone.R_kidney_stone.T

    def room(center: Array) -> float:
        return float(lumen.clearance_mm(center + rim).min())

    if room(stone.center_mm) < 0:
        return None
    step = 0.5 * lumen.grid.voxel_mm * np.concatenate([np.eye(3), -np.eye(3)])
    around = lumen.clearance_mm(stone.center_mm + step)
    down = around[3:] - around[:3]
    down = down / np.linalg.norm(down) if np.linalg.norm(down) > 1e-6 else rng.standard_normal(3)
    low, high = 0.0, 2 * float(lumen.clearance_mm(stone.center_mm[None])[0]) + 1e-3
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if room(stone.center_mm + middle * down) >= 0 else (low, middle)
    return Stone(stone.center_mm + low * down, stone.radii_mm, stone.R_kidney_stone, stone.bgr, stone.bumps, stone.seed)


def _is_free(stone: Stone, others: Sequence[Stone], start_mm: Array, apart_mm: float) -> bool:
    """Whether a stone lies clear of the others and of the scope's start."""
    reach = float(stone.radii_mm.max())
    if np.linalg.norm(stone.center_mm - start_mm) < reach + 2.5 * apart_mm:
        return False
    return all(
        np.linalg.norm(stone.center_mm - o.center_mm) > reach + float(o.radii_mm.max()) + apart_mm for o in others
    )
