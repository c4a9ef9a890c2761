"""Planning the virtual views: where the scope can stand, and what it can look at from there."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between, look_along
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.scaling import scaled

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """Which views a VID has; mm at the kidney's scale 1.

    Attributes:
        views_per_calyx: views labeled with each calyx.
        passage_views: views along the way from the pelvis to where the calyces' own views begin.
        around: so many views for each of those look any way the scope can bend to, most of them where there is room
            to turn: between calyces, and as it comes in, a scope looks at walls that lie on no way. On the choosing
            flights, 0, 240 and 480 of them give a place in 71.8, 94.0 and 94.5 % of pictures (`benchmarks.flights
            half=choosing around=0`, 4 and 8, with 60 passage views; regions of 10 mm were places then).
        nearest_mm, farthest_mm: range of distances along the centerline from a calyx's tip.
        tilt_deg: spread (standard deviation) of the viewing direction about the way in; the scope's wrist.
        largest_tilt_deg: no view beyond.
        roll_deg: views are rolled at random within plus or minus this; 0 suits features that are compared at every
            roll.
        scope_radius_mm: the camera keeps this far from the wall.
        stretch_mm: a passage narrower than the scope gives way by this much; the camera then keeps to its middle.
        bending_length_mm, largest_bend_deg: the scope's flexible tip (thesis §4.3.1: 20 mm, 120 degrees); a view
            direction farther from the way's direction that much before is out of reach.
        seed: same seed, same views.
    """

    views_per_calyx: int = 240
    passage_views: int = 240
    around: float = 2.0
    nearest_mm: float = 2.5
    farthest_mm: float = 13.0
    tilt_deg: float = 16.0
    largest_tilt_deg: float = 45.0
    roll_deg: float = 0.0
    scope_radius_mm: float = 1.0
    stretch_mm: float = 0.6
    bending_length_mm: float = 20.0
    largest_bend_deg: float = 120.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.views_per_calyx < 1 or self.passage_views < 0 or not 0 <= self.around <= 100:
            raise InputError(
                "A VID needs views_per_calyx >= 1, passage_views >= 0 and 0 <= around <= 100, got "
                f"{self.views_per_calyx}, {self.passage_views} and {self.around}."
            )
        if not 0 < self.nearest_mm < self.farthest_mm:
            raise InputError(f"Expected 0 < nearest_mm < farthest_mm, got {self.nearest_mm} and {self.farthest_mm}.")
        if not 0 <= self.stretch_mm <= 2:
            raise InputError(f"Expected 0 <= stretch_mm <= 2, got {self.stretch_mm}.")
        if not 0 < self.scope_radius_mm < 10 or not 0 <= self.tilt_deg or not 0 < self.largest_tilt_deg < 180:
            raise InputError(
                "Expected 0 < scope_radius_mm < 10, tilt_deg >= 0 and 0 < largest_tilt_deg < 180, got "
                f"{self.scope_radius_mm}, {self.tilt_deg} and {self.largest_tilt_deg}."
            )


#: A way's direction is the chord over this length ahead, mm at scale 1; near the tip over half of it back.
LOOK_AHEAD_MM = 4.0
#: In a passage narrower than the scope the camera keeps this part of the passage's radius from the wall.
_MIDDLE = 0.8


@dataclass(frozen=True, slots=True)
class Plan:
    """Poses to draw.

    Attributes:
        T_kidney_camera: (V, 4, 4).
        calyx: (V,) index of the calyx observed by the rule of `observed_calyx`, -1 for none.
    """

    T_kidney_camera: Array
    calyx: IntArray


def plan_views(kidney: Kidney, lumen: LumenDistance, settings: PlanSettings) -> Plan:
    """Views before every calyx, evenly spread over distance, offset and tilt, along the passages, and all around.

    Raises:
        InputError: a calyx has too little room for the scope; the message names it.
    """
    settings = scaled(settings, kidney.scale)
    parts = [_calyx_views(kidney, lumen, settings, calyx) for calyx in range(len(kidney.calyces))]
    parts += [_passage_views(kidney, lumen, settings), _around_views(kidney, lumen, settings)]
    T = np.concatenate(parts)
    return Plan(T, observed_calyx(T, kidney, lumen))


def _calyx_views(kidney: Kidney, lumen: LumenDistance, settings: PlanSettings, calyx: int) -> Array:
    """The views (views_per_calyx, 4, 4) that are labeled with one calyx."""
    way = _Way.to_calyx(kidney, calyx)
    near, far = settings.nearest_mm, min(settings.farthest_mm, way.length)
    found: list[Array] = []
    count, rounds = 0, 0
    sequence = qmc.Sobol(6, seed=settings.seed * 1009 + calyx)
    while count < settings.views_per_calyx:
        u = sequence.random(2 ** int(np.ceil(np.log2(4 * settings.views_per_calyx))))
        T = _poses(way, way.length - (near + u[:, 0] * (far - near)), u[:, 1:], lumen, settings)
        T = T[observed_calyx(T, kidney, lumen) == calyx]
        found.append(T)
        count, rounds = count + len(T), rounds + 1
        if rounds == 20 and count < settings.views_per_calyx:
            raise InputError(
                f"Calyx {kidney.calyces[calyx].name} has room for only {count} of {settings.views_per_calyx} views: "
                f"its lumen is too narrow for a scope of radius {settings.scope_radius_mm:g} mm, or another calyx's "
                "tip lies in every line of sight. Lower views.scope_radius_mm, or take that row out of the calyces "
                "file."
            )
    return np.concatenate(found)[: settings.views_per_calyx]


def _passage_views(kidney: Kidney, lumen: LumenDistance, settings: PlanSettings) -> Array:
    """Views (passage_views, 4, 4) on the way in, farther from every tip than the calyces' own views."""
    if settings.passage_views == 0:
        return np.zeros((0, 4, 4))
    ways = [_Way.to_calyx(kidney, calyx) for calyx in range(len(kidney.calyces))]
    room = np.array([max(way.length - settings.farthest_mm, 1.0) for way in ways])
    u = qmc.Sobol(7, seed=settings.seed * 1009 + 997).random(2 ** int(np.ceil(np.log2(8 * settings.passage_views))))
    chosen = np.searchsorted(np.cumsum(room) / room.sum(), u[:, 6], side="right").clip(0, len(ways) - 1)
    parts = [
        _poses(way, u[chosen == i, 0] * room[i], u[chosen == i, 1:6], lumen, settings) for i, way in enumerate(ways)
    ]
    T = np.concatenate(parts)
    order = np.random.default_rng(settings.seed).permutation(len(T))
    return T[order[: settings.passage_views]]


def _around_views(kidney: Kidney, lumen: LumenDistance, settings: PlanSettings) -> Array:
    """Views (N, 4, 4) in every direction within reach, the more of them the wider the lumen is there.

    Raises:
        InputError: there is no room for them.
    """
    needed = round(settings.around * settings.passage_views)
    if needed == 0:
        return np.zeros((0, 4, 4))
    wide = replace(settings, tilt_deg=np.inf, largest_tilt_deg=179.0)
    ways = [_Way.to_calyx(kidney, calyx) for calyx in range(len(kidney.calyces))]
    sequence, found, count = qmc.Sobol(8, seed=settings.seed * 1009 + 499), list[Array](), 0
    for _ in range(20):
        u = sequence.random(2 ** int(np.ceil(np.log2(16 * needed))))
        chosen = np.minimum((u[:, 6] * len(ways)).astype(int), len(ways) - 1)
        for i, way in enumerate(ways):
            at, v = u[chosen == i, 0] * (way.length - settings.nearest_mm), u[chosen == i]
            kept = v[:, 7] < (way.at(at)[1] / way.radius_mm.max()) ** 2
            found.append(_poses(way, at[kept], v[kept, 1:6], lumen, wide))
            count += len(found[-1])
        if count >= needed:
            T = np.concatenate(found)
            return T[np.random.default_rng(settings.seed + 1).permutation(len(T))[:needed]]
    raise InputError(f"The lumen has room for only {count} of {needed} views around; lower views.around.")


def _poses(way: "_Way", at_mm: Array, u: Array, lumen: LumenDistance, settings: PlanSettings) -> Array:
    """Poses at lengths ``at_mm`` (N,) of a way, spread by uniform numbers ``u`` (N, 5), less those out of reach."""
    center, radius, forward = way.at(at_mm)
    side, up = _across(forward)
    least = settings.scope_radius_mm - settings.stretch_mm
    room = np.maximum(radius - settings.scope_radius_mm, 0.0)
    offset, turn = (room * np.sqrt(u[:, 0]))[:, None], 2 * np.pi * u[:, 1:2]
    position = center + offset * (np.cos(turn) * side + np.sin(turn) * up)
    tilt = _tilts(u[:, 2], settings.tilt_deg)
    around = 2 * np.pi * u[:, 3:4]
    aside = np.cos(around) * side + np.sin(around) * up
    direction = np.cos(tilt)[:, None] * forward + np.sin(tilt)[:, None] * aside
    roll = np.radians(settings.roll_deg) * (2 * u[:, 4] - 1)
    _, _, behind = way.at(np.maximum(at_mm - settings.bending_length_mm, 0.0))
    keep = (tilt <= np.radians(settings.largest_tilt_deg)) & (
        angle_between(behind, direction) <= np.radians(settings.largest_bend_deg)
    )
    needed = np.minimum(settings.scope_radius_mm, np.maximum(_MIDDLE * radius, least))
    keep &= lumen.clearance_mm(position) >= needed
    return look_along(position[keep], direction[keep], roll[keep])


def _tilts(u: Array, sd_deg: float) -> Array:
    """Angles (N,), radians, of directions spread normally about an axis; evenly over the sphere where sd is inf."""
    if np.isinf(sd_deg):
        return np.asarray(np.arccos(1 - 2 * u))
    return np.asarray(np.radians(sd_deg) * np.sqrt(-2 * np.log(1 - 0.999 * u)))


@dataclass(frozen=True, slots=True)
class _Way:
    """The centerline from the pelvis to one tip, by arc length."""

    along_mm: Array
    points_mm: Array
    radius_mm: Array
    look_ahead_mm: float

    @classmethod
    def to_calyx(cls, kidney: Kidney, calyx: int) -> "_Way":
        path = kidney.centerline.path_to(calyx)
        points = kidney.centerline.points_mm[path]
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return cls(np.concatenate([[0.0], np.cumsum(step)]), points, kidney.centerline.radius_mm[path],
                   LOOK_AHEAD_MM * kidney.scale)  # fmt: skip

    @property
    def length(self) -> float:
        return float(self.along_mm[-1])

    def at(self, along_mm: Array) -> tuple[Array, Array, Array]:
        """Points (N, 3), radii (N,) and directions (N, 3) at lengths (N,); directions look ahead."""

        def point(s: Array) -> Array:
            return np.stack([np.interp(s, self.along_mm, self.points_mm[:, i]) for i in range(3)], axis=-1)

        here = point(along_mm)
        half = self.look_ahead_mm / 2
        ahead = np.minimum(along_mm + 2 * half, self.length)
        back = np.minimum(along_mm, self.length - half)
        forward = point(ahead) - np.where((ahead - along_mm > half)[:, None], here, point(back))
        forward /= np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
        return here, np.interp(along_mm, self.along_mm, self.radius_mm), forward


def _across(forward: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) at right angles to ``forward`` (N, 3) and to each other."""
    T = look_along(np.zeros_like(forward), forward)
    return T[..., :3, 0], T[..., :3, 1]
