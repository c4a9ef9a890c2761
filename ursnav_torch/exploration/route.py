"""The way from the tip of the scope to a calyx: along which branches, how far, and whether the scope bends enough."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import Kidney
from ursnav_torch.scaling import scaled

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ScopeLimits:
    """What the scope can do; mm at the kidney's scale 1.

    Attributes:
        largest_bend_deg, bending_length_mm: of the flexible tip (thesis §4.3.1: 120 degrees over 20 mm).
        radius_mm: the way is too narrow where its clearance is less.
        short_mm: a way may end this far before the calyx's tip.
    """

    largest_bend_deg: float = 120.0
    bending_length_mm: float = 20.0
    radius_mm: float = 1.0
    short_mm: float = 4.0

    def __post_init__(self) -> None:
        if not 0 < self.largest_bend_deg <= 360 or min(self.bending_length_mm, self.radius_mm) <= 0:
            raise InputError(f"The scope's limits must be positive and its bend at most 360 degrees, got {self}.")


@dataclass(frozen=True, slots=True)
class Route:
    """A way along the centerline.

    Attributes:
        calyx: name of the calyx it leads to.
        branches: names of the branches passed, in order.
        points_mm: (K, 3) from the place on the centerline nearest to the start, kidney frame.
        length_mm: along them.
        back_mm: how much of it is pulling back before the way in begins.
        bend_deg: largest bend that the flexible tip needs anywhere on the way in.
        narrowest_mm: smallest clearance on the way in.
        feasible: whether the scope's limits allow it.
    """

    calyx: str
    branches: tuple[str, ...]
    points_mm: Array
    length_mm: float
    back_mm: float
    bend_deg: float
    narrowest_mm: float
    feasible: bool


def route_to(kidney: Kidney, position_mm: Array, calyx: int, limits: ScopeLimits | None = None) -> Route:
    """The way from a place (3,) in the lumen, kidney frame, to a calyx (index).

    Raises:
        InputError: there is no such calyx.
    """
    limits = limits or ScopeLimits()
    of_kidney = scaled(limits, kidney.scale)
    if not 0 <= calyx < len(kidney.calyces):
        raise InputError(f"The kidney has calyces 0 to {len(kidney.calyces) - 1}, got {calyx}.")
    tree, inward = kidney.centerline, kidney.centerline.path_to(calyx)
    outward = to_root(tree.parent, node_at(kidney, position_mm))
    shared = len(set(outward) & set(inward.tolist()))
    back = outward[: len(outward) - shared + 1]
    path = np.array([*back, *inward[shared:]])
    points = tree.points_mm[path]
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    bend = bend_needed_deg(kidney, calyx, limits)
    ahead = inward[along(tree.points_mm[inward])[-1] - along(tree.points_mm[inward]) >= of_kidney.short_mm]
    narrowest = float(tree.radius_mm[ahead].min()) if len(ahead) else float(tree.radius_mm[inward[0]])
    return Route(
        kidney.calyces[calyx].name,
        tuple(name for name, _ in groupby(branch_names(kidney)[n] for n in path)),
        points,
        float(step.sum()),
        float(step[: len(back) - 1].sum()),
        bend,
        narrowest,
        bend <= limits.largest_bend_deg and narrowest >= of_kidney.radius_mm,
    )


def nearest_route(
    kidney: Kidney, position_mm: Array, calyces: Collection[int], limits: ScopeLimits | None = None
) -> Route | None:
    """The shortest feasible way to one of some calyces, or the shortest of all where none is feasible.

    It starts at a place (3,) in the lumen, kidney frame. None when there is nothing to go to.
    """
    ways = [route_to(kidney, position_mm, calyx, limits) for calyx in calyces]
    return min(ways, key=lambda way: (not way.feasible, way.length_mm), default=None)


@lru_cache(maxsize=64)
def bend_needed_deg(kidney: Kidney, calyx: int, limits: ScopeLimits) -> float:
    """Largest angle on the way to a calyx between the way's direction and its direction a bending length before.

    The shaft follows the centerline from the pelvis; before the pelvis it is taken as straight.
    """
    points, limits = kidney.centerline.points_mm[kidney.centerline.path_to(calyx)], scaled(limits, kidney.scale)
    length = along(points)
    stations = np.arange(0.0, max(length[-1] - limits.short_mm, 0.5), 0.5)
    look = 2.0 * kidney.scale

    def direction(at: Array) -> Array:
        ahead, behind = (np.clip(at + d, 0, length[-1]) for d in (look, -look))
        way = [np.interp(ahead, length, points[:, i]) - np.interp(behind, length, points[:, i]) for i in range(3)]
        return np.stack(way, 1)

    before = np.maximum(stations - limits.bending_length_mm, 0.0)
    return float(np.degrees(angle_between(direction(before), direction(stations)).max()))


@lru_cache(maxsize=4)
def branch_names(kidney: Kidney) -> tuple[str, ...]:
    """Name of the branch of every node of the centerline: ``pelvis``, ``infundibulum to A, B`` or ``calyx A``."""
    tree = kidney.centerline
    leads = [{int(c)} if c >= 0 else set() for c in tree.calyx]
    for node in range(len(leads) - 1, 0, -1):
        leads[int(tree.parent[node])] |= leads[node]
    every = set(range(len(kidney.calyces)))

    def name(calyces: set[int]) -> str:
        names = [kidney.calyces[c].name for c in sorted(calyces)]
        if calyces == every and len(every) > 1:
            return "pelvis"
        return f"calyx {names[0]}" if len(names) == 1 else f"infundibulum to {', '.join(names)}"

    return tuple(name(calyces) for calyces in leads)


def node_at(kidney: Kidney, position_mm: Array) -> int:
    """The node of the centerline whose ball of clearance a place (3,) lies deepest in."""
    tree = kidney.centerline
    away = np.linalg.norm(tree.points_mm - np.asarray(position_mm, float), axis=1)
    return int((away / np.maximum(tree.radius_mm, 1e-6)).argmin())


def to_root(parent: IntArray, node: int) -> list[int]:
    """The nodes from one to the root of a tree, both included; ``parent`` (N,) as of `Centerline`."""
    way = [node]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return way


def along(points: Array) -> Array:
    """(K,) length of a polyline (K, 3) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
